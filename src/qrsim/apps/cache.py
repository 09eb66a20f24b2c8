"""``qrsim cache``: the compiled programs that are kept from one run to the next."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Info:
    """Print where compiled programs are kept, how many there are, and their size.

    Example:
      qrsim cache info
      qrsim cache info --json
    """

    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Print a line on the cached programs of each kind: number and size."""
        import json

        from qrsim.engine import packing

        found = packing.contents()
        if self.json:
            rows = {
                kind: {"folder": str(each.folder), "files": each.files, "size_bytes": each.size_bytes}
                for kind, each in found.items()
            }
            print(json.dumps({"processor": packing.processor(), "kinds": rows}, indent=2))
            return
        if not found:
            print("off: QRSIM_COMPILATION_CACHE is off")
        for kind, each in found.items():
            print(f"{kind:<9} {each.files:5d} files {each.size_bytes / 2**20:8.1f} MiB  {each.folder}")


@dataclass(frozen=True)
class Clear:
    """Delete every compiled program; the next flights compile again.

    Example:
      qrsim cache clear
    """

    def run(self) -> None:
        """Delete the cached compiled programs, and print their number and size."""
        from qrsim.engine import packing

        found = packing.clear().values()
        size = sum(each.size_bytes for each in found)
        print(f"deleted {sum(each.files for each in found)} files, {size / 2**20:.1f} MiB")


@dataclass(frozen=True)
class Pack:
    """Write the compiled programs for this processor to an archive for other machines.

    Example:
      qrsim cache pack programs.tar.gz
    """

    archive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """File to write; compressed if its name ends in .gz or .tgz."""

    def run(self) -> None:
        """Write the cached compiled programs to an archive, and print their number."""
        from qrsim.engine import packing

        count = packing.pack(self.archive)
        print(f"packed {count} programs, {self.archive.stat().st_size / 2**20:.1f} MiB: {self.archive}")


@dataclass(frozen=True)
class Unpack:
    """Put the programs of an archive into the cache. They are machine code: unpack only what you trust.

    Example:
      qrsim cache unpack programs.tar.gz
    """

    archive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """File that 'qrsim cache pack' wrote on a machine with the same processor."""

    def run(self) -> None:
        """Unpack an archive of compiled programs into the cache, and print their number."""
        from qrsim.engine import packing

        print(f"unpacked {packing.unpack(self.archive)} programs")
