"""The peer bench: other people's ways to a camera's pan and focal length, on the same frames as ours. docs/peers.md."""
