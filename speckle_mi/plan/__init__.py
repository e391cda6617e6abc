"""Which ways the light takes, and which stages each of them needs."""
