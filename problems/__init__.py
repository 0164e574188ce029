"""Problems, each a file that `casid` loads by its path, and that studies import from here.

A file of a problem in several parts imports what lies beside it in both ways:

    if TYPE_CHECKING or __package__:
        from problems.ship_hull import Ship
    else:  # loaded by its path
        from ship_hull import Ship
"""
