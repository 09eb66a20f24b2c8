"""A small participant of RTPS, the wire protocol of DDS, that answers services for clients of every middleware."""
