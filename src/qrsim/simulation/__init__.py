"""Simulations: one world step by step, many worlds at once, states as bytes.

Its functions are compiled by ``engine``; the order of a tick is in ``world``.
It may import ``interface`` and the layers below it.
Read ``simulation.py`` first.
"""
