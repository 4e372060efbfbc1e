"""One size for each tracked object (MI-UP, section 4.3)."""
