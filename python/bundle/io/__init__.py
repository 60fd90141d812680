"""Files in, files out, whole."""
