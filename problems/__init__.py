"""Problems, each a file that `casid` loads by its path, and that studies import from here.

What a system needs beyond its file lies in a folder beside it: `ship_simulator/` holds the parts of
`ship_4dof.py`. The folder has a name of its own, because Python cannot have both: of a file
`ship.py` and a folder `ship/` one hides the other in every import. Files in the folder import each
other by relative imports; the problem file imports from the folder in both ways:

    if TYPE_CHECKING or __package__:
        from problems.ship_simulator.hull import Ship
    else:  # loaded by its path
        from ship_simulator.hull import Ship
"""
