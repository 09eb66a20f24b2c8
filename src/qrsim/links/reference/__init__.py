"""The TCP protocol of the reference implementation: messages, server and client."""
