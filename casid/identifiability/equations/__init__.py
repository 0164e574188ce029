"""Systems from equation files, from text and from models that are fitted."""
