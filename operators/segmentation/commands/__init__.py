"""Commands about segmentation."""
