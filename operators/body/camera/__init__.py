"""People in the image of an ordinary camera, which measures no depth: found, followed, and placed in metres."""
