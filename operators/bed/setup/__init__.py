"""Setting up a bedside camera: does it see the bed as it must?"""
