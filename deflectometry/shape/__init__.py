"""Screen points become slopes, slopes a map with random and common uncertainty."""
