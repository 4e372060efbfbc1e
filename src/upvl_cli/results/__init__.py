"""What a workspace made, for scripts and notebooks."""
