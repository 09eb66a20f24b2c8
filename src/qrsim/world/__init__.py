"""One world of fleets: its parameters (World), its state (State), and the order of a tick.

Everything in it is a pure function of both, for one world; ``simulation`` has them compiled.
It may import ``control`` and the layers below it.
Read ``tick.py`` first.
"""
