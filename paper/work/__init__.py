"""The work of the stages: flights, networks, filters, and scores."""
