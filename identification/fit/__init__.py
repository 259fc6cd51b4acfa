"""Fine-tuning of all parameters on records: the problem, three ways to solve it, the doubt that comes with the solution."""
