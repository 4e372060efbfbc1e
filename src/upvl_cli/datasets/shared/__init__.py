"""What dataset adapters share."""
