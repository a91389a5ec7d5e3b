"""What acts on an object in a transfer: an ideal grip, or contact."""
