"""The indirect model as transfer functions: unknown inputs replaced by measurements of them."""
