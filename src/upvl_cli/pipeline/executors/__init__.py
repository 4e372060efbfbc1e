"""Where shards are made: this process, several processes, a Ray cluster or a SLURM queue.

An executor says where a shard is made. Whether it has to be made, its stamp says: `make_shard` asks for it again on
the machine that would make it, so that work that is given out twice is done once.
"""
