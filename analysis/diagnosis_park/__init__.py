"""How often does the diagnosis name what is hidden in systems of any domain?"""
