"""The brief before a field day: whether an operation is a go, marginal or a no-go, with the statistics behind it.

It flies studies of ``sweep`` and reads their stores. No other study imports it.
Read ``operation.py`` first.
"""
