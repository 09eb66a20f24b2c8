"""The live 3-D page: what is drawn, the page around it, and how a simulation or a recording feeds it.

Needs viser, which 'qrsim[view]' installs; nothing here is imported until somebody looks. Everything is drawn in NED.
"""
