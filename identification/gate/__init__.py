"""The quality gate: what a campaign's files, and a fit to them, say of themselves before anyone trusts them."""
