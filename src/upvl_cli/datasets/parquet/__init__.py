"""The open door: drives that anybody writes as Parquet tables (docs/datasets/parquet.md), read in place."""
