"""What stages do: flights, networks, filters, and scores of these."""
