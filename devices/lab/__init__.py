"""`kinegraph lab`: set up, run and finish sessions in a browser."""
