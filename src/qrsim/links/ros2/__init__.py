"""ROS 2 without a ROS installation: its messages, topics and frames, over DDS."""

from __future__ import annotations

from typing import Any

# A message of ROS or its part, of a class that is made at run time; a type checker cannot see into it.
Message = Any
