"""The Waymo Open Dataset's definitions of detection and tracking scores, equal to its own tools to the digit."""
