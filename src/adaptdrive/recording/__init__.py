"""Recording: every tick and slow step of a session on disk, and the way back to commands.

The control process packs reports and feeds them through a pipe to a recorder process of its own,
which alone touches the disk. Nothing here can block or fail a tick.
"""
