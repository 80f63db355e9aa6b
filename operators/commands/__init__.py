"""`kinegraph files fetch`, and what several commands share."""
