"""ROS 2 without a ROS installation: its messages, topics and frames, over DDS."""
