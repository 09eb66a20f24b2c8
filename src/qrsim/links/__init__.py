"""Connections to other software: MAVLink, ROS 2, autopilot firmware, the reference protocol.

Each protocol has a folder. ``shared/`` has one world for several controllers and knows no protocol.
It may import ``envs``, ``view`` and the layers below them.
Read ``contracts.py`` first.
"""
