"""Physical models: vehicles, atmosphere, GNSS, sensors, radio and the scene, a folder for each.

A component is one file: a record of its parameters, with pure methods. ``contracts.py`` of each folder
lists the methods of its kinds.
It may import ``core``, ``files`` and the layers below them.
Read ``vehicles/quadrotor.py`` first.
"""
