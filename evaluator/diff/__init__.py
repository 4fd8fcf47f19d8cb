"""Two recordings, or environments of one, held against each other: where they part first, and how fast.

    compare    reads what both have once and makes the Difference, which is in result
    common     the two sides, environments of a recording each; fields, items and steps that both have
    states     the states of these steps, and whether the bodies are the same in another order
    splits     the state hashes of these steps; what is equal at each, and classes of environments
    numbers    how the numbers of a field are compared, and how many differ
    walk       reads states and hashes step by step into these, and how far bodies lie apart
    first      the first step that differs, and the first pair of numbers
    settings   what the two recordings say of themselves
    program    which part of a program differs first, of parts in program_parts
    arrays     arrays that no file holds, for gpusimbench.testing and gsb-replay

What is said of a Difference: brief is the verdict and what stands below it, sections the rest and the JSON, remarks
what was not compared, figure the picture; words has numbers, names and parts of programs in text.
"""
