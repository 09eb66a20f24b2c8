"""Range-only SLAM on flights of the simulator, under white and under coloured GNSS noise (docs/slam.md)."""
