"""How visible must a cause be to be told from another, and does the advised experiment help?"""
