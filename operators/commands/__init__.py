"""Commands that packages of operators extend: `kinegraph train` and `kinegraph evaluate`."""
