"""The quality gate: checks of a campaign's files, and of a fit to them."""
