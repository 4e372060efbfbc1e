"""The web page of a workspace: search, hits, their 3D view and downloads; read-only, on this machine by default."""
