"""The engine: stages, shards, stamps, and what runs them. It knows no stage, dataset or model by name."""
