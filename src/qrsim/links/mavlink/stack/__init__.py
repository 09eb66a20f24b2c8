"""The flight stack of one vehicle: modes, arming, missions, set-points and failsafes; no bytes and no sockets."""
