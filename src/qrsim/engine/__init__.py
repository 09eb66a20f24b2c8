"""How a program is compiled and kept: settings, layouts of trees in memory, cache, machine code."""
