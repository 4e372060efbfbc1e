"""Use cases behind one command each; they return text and files, and print nothing."""
