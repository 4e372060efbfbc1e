"""Text queries over what was labelled or detected: which boxes are what a person asks for, without a picture."""
