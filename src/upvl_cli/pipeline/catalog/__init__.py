"""What every shard's footer says, kept beside the shards, so that a listing is enough to know what is fresh."""
