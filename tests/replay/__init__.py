"""What kinegraph does, graph by graph: each file replays a recording through one shipped graph and checks its answers by other means.

Read `test_treadmill_emg.py` first. The recordings are in tests/recordings/real; its README names their sources and terms.
"""
