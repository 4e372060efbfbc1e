"""Training data of the detector: frames of drives, their order, random changes and batches."""
