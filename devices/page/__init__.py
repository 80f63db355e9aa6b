"""The page: a session or a recording in a browser; its server is a process of its own, and loses its own data when it is slow."""
