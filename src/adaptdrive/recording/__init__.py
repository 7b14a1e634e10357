"""Recording: every tick and slow step of a session on disk, and the way back to commands.

The control process hands reports over to a log, which threads write; an archiver process makes
sessions of it. Nothing here can block or fail a tick.
"""
