"""Mathematics for all other rooms: records as PyTrees, vectors, clocks, random numbers, elementary functions.

It knows neither vehicles nor files. Of other packages it uses jax and numpy only.
It may import ``extras`` and the layers below it.
Read ``tree.py`` first.
"""
