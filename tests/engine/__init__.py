"""The engine: graphs from YAML, sessions, replay, promises, what goes wrong and how it ends."""
