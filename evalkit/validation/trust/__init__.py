"""How far can metrics, and the harness itself, be trusted?"""
