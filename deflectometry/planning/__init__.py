"""Plans of measurements whose source stands before the mirror: what each will be worth, before there are images."""
