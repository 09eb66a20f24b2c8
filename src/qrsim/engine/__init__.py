"""The compiler: from a pure function of one world to machine code, and the cache that keeps the code.

``backend.py`` is its only interface. It compiles with ``llvm/``, and with XLA when ``llvm/`` refuses a function.
It may import ``core``, ``files`` and the layers below them.
Read ``backend.py`` first.
"""
