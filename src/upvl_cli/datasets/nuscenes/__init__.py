"""nuScenes, and data sets in its tables: Lyft Level 5 and TIER IV's T4."""
