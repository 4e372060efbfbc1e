"""Labels in the formats of other tools, one file a format with its reader back."""
