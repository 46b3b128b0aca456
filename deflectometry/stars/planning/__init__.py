"""When of a night the stars say most about the facets: stars to be seen, sigmas to be expected."""
