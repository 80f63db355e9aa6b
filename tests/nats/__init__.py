"""Tests of NATS JetStream between machines, and of the ward."""
