"""All checks, in the order of the questions that a new adapter meets: cheap ones first, formulas before recordings."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.recorder.conformance.checks import (
    agreement,
    description,
    evidence,
    given,
    motion,
    recorded,
    state,
)
from gpusimbench.recorder.conformance.subject import Subject

Check = Callable[[Subject], None]
"""Returns where all is well; AssertionError says what was expected and found, NotApplicable why it cannot be asked."""

# Those that step the conformance scene follow each other: a program that JAX makes anew after it has traced another
# scene has other names in it, and is not found in JAX's cache of compiled programs.
CHECKS: tuple[Check, ...] = (
    description.importing_needs_no_engine,
    description.class_keeps_the_contract,
    description.says_what_it_is,
    description.layout_is_as_the_format_asks,
    state.first_state_is_the_scenes,
    state.envs_start_alike,
    state.registered_scenes_start_as_described,
    state.compile_moves_nothing,
    motion.states_are_finite,
    motion.quaternions_are_normalised,
    motion.turns_counter_clockwise,
    motion.angular_velocity_is_in_the_world_frame,
    motion.free_flight_follows_gravity,
    motion.stack_at_rest_stays,
    motion.ball_rolls_down_the_slope,
    evidence.gates_stay_silent,
    evidence.evidence_has_a_row_for_every_step,
    evidence.overflow_stays_silent,
    evidence.contacts_hold_up_the_stack,
    evidence.contacts_change_when_a_pebble_lands,
    description.buffers_are_measured,
    evidence.buffers_are_larger_than_what_they_held,
    agreement.captured_states_stay,
    agreement.blocks_ahead_are_the_same,
    agreement.flights_hold_the_captured_states,
    agreement.step_and_states_agree,
    evidence.counts_agree_step_by_step,
    state.claims_are_kept,
    state.reset_is_a_fresh_start,
    state.resetting_some_leaves_others,
    state.restored_before_compile_repeats,
    state.restored_state_repeats,
    state.restoring_some_leaves_others,
    state.set_state_is_shown,
    state.set_state_starts_afresh,
    given.actions_are_those_drawn,
    given.varied_envs_are_those_of_their_scenes,
    recorded.run_is_recorded_whole,
    recorded.recording_says_what_it_is_of,
    recorded.timed_steps_lead_where_captured_ones_do,
)
