"""Scenario files: the built-in ones, the schema, the checks, and the way from a scenario to a World.

``catalogue.py`` maps names to components, ``registry.py`` adds components from outside the package.
It may import ``tasks`` and the layers below it.
Read ``scenario.py`` first.
"""
