"""What adapters of datasets share: files, text, numbers, poses, pictures, tables; each wrong one is one clear line."""
