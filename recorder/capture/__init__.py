"""States, actions, counts, hashes and readings of memory, from arrays to the file.

The capture phase (recorder.run.capture_phase) puts these together; a module uses those below it:

    stepping      the loop: an engine makes blocks of steps, while a thread writes those before; the clock of both
    writing       the thread that writes blocks in order
    states        writes states; state_work hashes, digests and checks them, in threads of this process or in the
                  processes that work_process starts, which run work_child
    ranges        how environments and steps are cut into messages, and the memory of a block
    actions, evidence, flight, view, array_hashes, samples
                  a writer for each other thing that a recording holds
    workers       threads that share the work on a block
    sink          the one file that all of them write to, and its way to the disk
"""
