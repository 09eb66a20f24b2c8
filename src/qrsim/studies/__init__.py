"""Studies on top of the simulator, each with its mathematics and a command in ``apps``.

``sweep`` flies many conditions, ``validate`` compares models with recordings, ``identify`` and ``discover`` fit
vehicles to flight logs, ``slam`` estimates trajectories, ``learn`` trains policies for tasks. They do not import each
other; all may import ``flight_logs``.
``brief``, the verdict before a field day, is on top of them.
It may import ``contracts`` and the layers below it.
Read ``sweep/study.py`` first.
"""
