"""The user's side of a simulation: actions, readings, policies and metrics, as NumPy arrays.

Actions are checked here before they reach the compiled tick, and readings are cut out of the packed state.
It may import ``world`` and the layers below it.
Read ``actions.py`` first.
"""
