"""The search under another noise: does the answer stand beside a random disturbance, or without?"""
