"""What draws: rays, mirrors, prints, sensors; images integrate over the pixel."""
