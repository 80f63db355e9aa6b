"""Depth cameras by their makers' libraries: Orbbec, RealSense, Azure Kinect; a file for each library, and what they share."""
