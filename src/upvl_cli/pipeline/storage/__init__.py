"""Object stores: paths of objects, whole-object writes, leases and a local cache bounded in bytes."""
