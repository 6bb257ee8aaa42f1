"""Turn a registration into an odometry: motion prior, scan-to-scan, scan-to-map, local maps."""
