"""Files of users: opened safely, read with limits, and written completely or not at all.

Regular files only, up to a size; YAML without repeated keys or deep nesting; code of users by name. Interruptions by
Ctrl-C and SIGTERM are here too, because writers have to finish.
It may import ``extras`` and the layers below it.
Read ``user_files.py`` first.
"""

from __future__ import annotations

from typing import Any

# A mapping as YAML and JSON have it.
Content = dict[str, Any]
