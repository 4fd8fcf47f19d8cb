"""All checks, in the order of the questions that a new adapter meets: cheap ones first, formulas before recordings."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.recorder.conformance.checks.actions import actions_are_those_drawn
from gpusimbench.recorder.conformance.checks.agreement import (
    blocks_ahead_are_the_same,
    captured_states_stay,
    flights_hold_the_captured_states,
    step_and_states_agree,
)
from gpusimbench.recorder.conformance.checks.description import (
    buffers_are_measured,
    class_keeps_the_contract,
    layout_is_as_the_format_asks,
    says_what_it_is,
)
from gpusimbench.recorder.conformance.checks.evidence import (
    buffers_are_larger_than_what_they_held,
    contacts_change_when_a_pebble_lands,
    contacts_hold_up_the_stack,
    counts_agree_step_by_step,
    evidence_has_a_row_for_every_step,
    gates_stay_silent,
    overflow_stays_silent,
)
from gpusimbench.recorder.conformance.checks.importing import importing_needs_no_engine
from gpusimbench.recorder.conformance.checks.motion import (
    angular_velocity_is_in_the_world_frame,
    ball_rolls_down_the_slope,
    free_flight_follows_gravity,
    quaternions_are_normalised,
    stack_at_rest_stays,
    states_are_finite,
    turns_counter_clockwise,
)
from gpusimbench.recorder.conformance.checks.recorded import (
    recording_says_what_it_is_of,
    run_is_recorded_whole,
    timed_steps_lead_where_captured_ones_do,
)
from gpusimbench.recorder.conformance.checks.start import (
    compile_moves_nothing,
    envs_start_alike,
    first_state_is_the_scenes,
    registered_scenes_start_as_described,
)
from gpusimbench.recorder.conformance.checks.state import (
    claims_are_kept,
    reset_is_a_fresh_start,
    resetting_some_leaves_others,
    restored_before_compile_repeats,
    restored_state_repeats,
    restoring_some_leaves_others,
    set_state_is_shown,
    set_state_starts_afresh,
)
from gpusimbench.recorder.conformance.checks.varied import varied_envs_are_those_of_their_scenes
from gpusimbench.recorder.conformance.subject import Subject

Check = Callable[[Subject], None]
"""Returns where all is well; AssertionError says what was expected and found, NotApplicable why it cannot be asked."""

# Those that step the conformance scene follow each other: a program that JAX makes anew after it has traced another
# scene has other names in it, and is not found in JAX's cache of compiled programs.
CHECKS: tuple[Check, ...] = (
    importing_needs_no_engine,
    class_keeps_the_contract,
    says_what_it_is,
    layout_is_as_the_format_asks,
    first_state_is_the_scenes,
    envs_start_alike,
    registered_scenes_start_as_described,
    compile_moves_nothing,
    states_are_finite,
    quaternions_are_normalised,
    turns_counter_clockwise,
    angular_velocity_is_in_the_world_frame,
    free_flight_follows_gravity,
    stack_at_rest_stays,
    ball_rolls_down_the_slope,
    gates_stay_silent,
    evidence_has_a_row_for_every_step,
    overflow_stays_silent,
    contacts_hold_up_the_stack,
    contacts_change_when_a_pebble_lands,
    buffers_are_measured,
    buffers_are_larger_than_what_they_held,
    captured_states_stay,
    blocks_ahead_are_the_same,
    flights_hold_the_captured_states,
    step_and_states_agree,
    counts_agree_step_by_step,
    claims_are_kept,
    reset_is_a_fresh_start,
    resetting_some_leaves_others,
    restored_before_compile_repeats,
    restored_state_repeats,
    restoring_some_leaves_others,
    set_state_is_shown,
    set_state_starts_afresh,
    actions_are_those_drawn,
    varied_envs_are_those_of_their_scenes,
    run_is_recorded_whole,
    recording_says_what_it_is_of,
    timed_steps_lead_where_captured_ones_do,
)
