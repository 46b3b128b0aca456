"""What the reports of all instruments are made of."""
