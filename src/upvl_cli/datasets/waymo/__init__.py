"""The perception part of the Waymo Open Dataset, read in place: v2 (Parquet) and v1 (TFRecord)."""
