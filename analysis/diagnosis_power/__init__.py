"""How often does the diagnosis name what is hidden, and how often something that is not there?"""
