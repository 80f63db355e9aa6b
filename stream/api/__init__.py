"""What Python programs and notebooks use: graphs built by calls, run on arrays, recordings and devices. `kinegraph` names it all."""
