#!/bin/sh
# Fly one take-off, a square and a landing with a real PX4 on qrsim, and print what differs from what is expected.
#
#   tools/try_px4.sh ~/PX4-Autopilot [FOLDER]
#
# The checkout is built (make px4_sitl_default) if it is not yet. FOLDER, by default px4-trial, gets the run, PX4's logs
# and report.txt. Needs qrsim and pymavlink in the Python that is run (PYTHON=...). Takes about three minutes.
set -eu
if [ $# -lt 1 ] || [ $# -gt 2 ] || [ ! -d "$1" ]; then
    echo "usage: tools/try_px4.sh PX4_CHECKOUT [FOLDER]" >&2
    exit 2
fi
build="$1/build/px4_sitl_default"
[ -x "$build/bin/px4" ] || make -C "$1" px4_sitl_default
exec "${PYTHON:-python3}" "$(dirname "$0")/try_px4.py" "$build" "${2:-px4-trial}"
