"""Segmentation, neighbours, features, motion maps and motion graphs."""
