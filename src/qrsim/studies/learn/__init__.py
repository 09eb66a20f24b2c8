"""Training of policies for tasks by proximal policy optimisation (docs/howto/train.md).

Episodes are flown side by side by the compiled simulator, and optax takes the steps of the gradient.
It may import ``flight_logs``, and the layers below ``studies``.
Read ``training.py`` first.
"""
