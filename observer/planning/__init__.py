"""What a flight will be worth before it is made."""
