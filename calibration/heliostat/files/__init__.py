"""Files of heliostats: results, residuals, folders of the PAINT database."""
