"""Runs spread over the machines of a Ray cluster: ``gsb-record --ray``.

Where the code of each module runs:

    connection.py  here: Ray, and nothing else that knows how Ray is spoken to
    seats.py       here: which parts of which nodes make runs, one at a time each
    team.py        here: the runs of a command, given to seats as these become free
    batch.py       here: which of these are to be made still, and what became of the others
    gathering.py   here: files of a node, copied piece by piece and checked
    agent.py       on the node, in a worker of Ray: starts one process; needs nothing of this project
    node.py        on the node, that process: makes one run, as it is made without Ray; and, also
                   here, which code of this project is imported

Between the machines go command lines, lines of JSON and pieces of files; no object of this project does.
"""
