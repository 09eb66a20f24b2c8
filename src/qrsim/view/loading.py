"""What a page says until its first frame is there: what is being loaded. The overlay removes it (overlay.js)."""

from __future__ import annotations

import html
import json

from viser import ViserServer

from qrsim.view.script import run_script

ELEMENT = "qrsim-loading"
STYLE = (
    "position:fixed;left:0;right:0;top:42%;padding:0 16px;text-align:center;font:15px/1.5 system-ui,sans-serif;"
    "color:#69737c;z-index:4;pointer-events:none;overflow-wrap:anywhere"
)


def show_loading(server: ViserServer, what: str) -> None:
    """Show in all browsers without a scene that ``what`` (one line of text) is being loaded."""
    script = f"""
if (!window.qrsim) {{
  const found = document.getElementById("{ELEMENT}") ?? document.createElement("div");
  found.id = "{ELEMENT}";
  found.style.cssText = "{STYLE}";
  found.textContent = "loading " + {json.dumps(what)} + " ...";
  document.body.append(found);
}}"""
    run_script(server, "loading", script, exported=False)


def loading_element(what: str) -> str:
    """Return the HTML element that an exported page shows while it loads ``what``."""
    return f'<div id="{ELEMENT}" style="{STYLE}">loading {html.escape(what)} ...</div>'
