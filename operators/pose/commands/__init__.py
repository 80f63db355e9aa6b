"""Commands of whole poses."""
