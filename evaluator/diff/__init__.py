"""Two recordings, or environments of one, held against each other: where they part first, and how fast.

    compare         reads what both have once and makes the Difference, which is in result
    selection       one side: environments of a recording
    common          fields, items and steps that both sides have
    states, hashes  the states, and the state hashes, of these steps
    numbers         how the numbers of a field are compared, and how many differ
    growth          how far bodies lie apart at each step
    splits          what is equal at each step, and classes of environments
    walk            reads states and hashes step by step into the three before
    first           the first step that differs, and the first pair of numbers
    order           whether the bodies are the same in another order
    settings        what the two recordings say of themselves
    program         which part of a program differs first, of parts in program_parts; program_words says it
    arrays          arrays that no file holds, for gpusimbench.testing and gsb-replay; array_sections says it

What is said of a Difference: verdict is the first line, brief what stands below it, sections the rest, remarks what was
not compared, figure the picture; words has numbers and names in text.
"""
