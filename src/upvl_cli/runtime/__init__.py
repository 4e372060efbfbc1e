"""What any room may use to work: threads, and files that appear whole or not at all."""
