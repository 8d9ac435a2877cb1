//! The conformance suite, for every way to connect two components of one process or of two, every language, and one calling the
//! other.
//!
//! Promise: a component cannot tell where its peer runs or what it is written in; what may happen is the same.

use trocar_tests::conformance::matrix::{self, Situation};
use trocar_tests::conformance::{
    BuiltProcesses, ExecIn, ExecOut, Lab, Language, Languages, OtherProcess, OtherProcessOfCalledBack,
    OtherProcessOfFreeClient, OtherProcessOfFreeServer, OtherProcessOfPassive, OtherProcessOnGrids,
    OtherProcessOnTurnedGrids, OtherThread, Passive, SameStream, SharedMemory, Way, cases,
};
use trocar_tests::skip;

/// One test per case.
macro_rules! tests {
    ($way:expr; $($from:ident $about:ident: $($case:ident),+;)+) => {
        /// Names of the cases.
        pub(super) const CASES: &[&str] = &[$($(stringify!($case)),+),+];
        $($(
            #[test]
            fn $case() {
                let way = $way;
                if let Some(why) = way.languages.missing() {
                    return skip(&why);
                }
                way.play($from::$about::$case);
            }
        )+)+
    };
}

/// One module per way; its list is the list of all cases.
macro_rules! conform {
    ($($module:ident: $deployment:ident, $client:ident calls $server:ident;)+) => {
        $(mod $module {
            use super::*;
            tests! {
                Way {
                    deployment: &$deployment,
                    languages: Languages { client: Language::$client, server: Language::$server },
                };
                cases commands:
                    every_kind_that_is_sent_arrives_once,
                    every_kind_that_is_sent_from_a_step_arrives_once,
                    every_kind_that_is_called_gives_its_result,
                    a_call_from_a_step_runs_inline_or_would_block,
                    commands_of_one_client_keep_their_order,
                    several_threads_of_a_client_use_one_function_at_once,
                    a_read_is_answered_from_the_published_row_with_its_stamp,
                    a_read_waits_for_nobody;
                cases outcomes:
                    nothing_connected_is_unbound,
                    a_server_that_is_not_active_says_so_and_can_still_be_read,
                    an_argument_outside_its_limits_never_reaches_the_server,
                    a_command_that_refuses_has_failed_with_its_own_sentence,
                    a_full_queue_refuses_and_keeps_what_it_has,
                    a_full_queue_gives_up_its_oldest_where_the_command_says_so,
                    the_latest_wins_where_the_command_says_so,
                    a_call_that_was_not_begun_by_its_deadline_never_runs,
                    a_call_without_a_deadline_has_that_of_its_connection,
                    a_call_without_any_deadline_ends_all_the_same,
                    a_call_that_was_begun_by_its_deadline_may_still_run,
                    a_command_that_panics_has_failed_and_puts_only_its_server_in_fault;
                cases events:
                    an_event_back_into_a_stepping_client_waits_for_the_end_of_the_step,
                    events_arrive_each_once_and_in_order,
                    every_observer_hears_every_event,
                    events_that_find_a_full_queue_are_counted_and_told_to_who_emits,
                    from_outside_one_can_wait_for_an_event,
                    whoever_waits_for_an_event_is_told_when_it_does_not_come,
                    events_are_followed_from_outside_in_order,
                    a_client_that_is_disconnected_hears_nothing_more,
                    events_of_a_command_from_outside_wake_the_client,
                    a_direct_handler_runs_inside_emit_where_both_share_a_thread,
                    a_direct_handler_of_a_client_that_is_busy_waits_like_any_other,
                    a_client_that_was_reset_hears_again;
                cases streams:
                    the_latest_value_is_shown_again_and_is_fresh_once,
                    a_full_queue_of_samples_drops_its_oldest_and_the_gap_says_how_many,
                    a_full_queue_of_samples_drops_the_newest_where_asked,
                    an_input_s_own_depth_counts_where_the_connection_names_none,
                    nothing_is_lost_without_being_counted_while_both_run,
                    one_output_feeds_many_inputs_each_at_its_own_pace,
                    a_sample_older_than_the_connection_allows_is_stale,
                    a_slow_consumer_misses_what_its_queue_cannot_hold_and_knows_how_much,
                    a_cut_stream_shows_nothing_and_a_new_one_starts_afresh,
                    an_input_is_rewired_in_one_request;
                cases frames:
                    a_frame_arrives_where_it_was_made,
                    a_frame_that_two_have_is_nobody_s_to_change,
                    a_filter_changes_a_frame_in_place,
                    a_queue_of_frames_gives_up_its_oldest_before_their_pool_is_empty,
                    a_queue_that_keeps_its_oldest_frames_takes_no_more_before_their_pool_is_empty,
                    an_exhausted_pool_is_a_counted_drop,
                    a_branch_that_takes_no_frames_costs_the_others_none,
                    the_threads_of_a_stream_work_on_slices_at_the_same_time,
                    a_filter_that_failed_is_bypassed_where_its_stream_says_so,
                    a_filter_that_failed_stops_its_branch_and_no_other;
                cases lifecycle:
                    start_is_refused_while_something_required_is_not_connected,
                    an_actuator_that_loses_its_peer_is_made_safe_and_stops,
                    an_actuator_whose_peer_is_removed_is_made_safe_and_stops,
                    an_actuator_whose_source_falls_silent_has_stale_input_and_goes_on,
                    one_can_wait_for_a_state_and_is_told_when_it_cannot_come,
                    a_disconnect_changes_no_other_component_s_state,
                    stop_makes_safe_and_resume_keeps_what_start_makes_anew,
                    a_step_that_fails_is_a_fault_with_its_sentence,
                    a_step_that_panics_is_a_fault_with_its_sentence,
                    a_command_that_does_not_come_back_is_unresponsive_and_the_host_goes_on,
                    everything_is_counted_from_a_reset_anew;
                cases loss:
                    a_call_whose_connection_is_cut_has_lost_its_peer,
                    a_call_whose_server_is_removed_is_told_so_and_never_runs,
                    a_call_whose_server_is_stopped_finds_it_not_active,
                    a_call_that_waits_in_a_server_that_goes_into_fault_is_answered,
                    a_client_that_is_removed_while_its_call_waits_is_answered_and_the_call_never_runs,
                    rewiring_while_calls_go_on_loses_none_and_answers_each;
                cases configuring:
                    a_live_setting_changes_while_the_component_runs,
                    any_other_setting_of_a_running_component_is_refused,
                    a_value_outside_its_limits_is_refused_whole,
                    a_configuration_survives_a_reset,
                    settings_change_under_load_and_each_answer_is_of_one_of_them;
                cases changing:
                    a_configuration_makes_ports_that_answer_each_for_itself,
                    what_stays_keeps_its_connections_and_what_goes_loses_them,
                    a_component_changes_its_ports_itself,
                    ports_that_contradict_each_other_are_refused_and_the_old_ones_stay,
                    ports_of_a_configuration_survive_a_reset,
                    calls_of_ports_that_come_and_go_are_each_answered_and_none_runs_twice;
                cases untyped:
                    an_untyped_input_takes_samples_and_frames_as_they_are,
                    a_frame_that_an_untyped_input_keeps_stays_whatever_becomes_of_the_input,
                    frames_are_held_as_long_as_enough_stay_free_for_their_source,
                    an_untyped_output_gives_what_its_peer_takes_and_nothing_of_another_size,
                    two_untyped_ends_pass_what_a_third_one_made_of_the_output,
                    an_untyped_function_calls_what_it_is_connected_to_and_nothing_of_another_size,
                    fields_that_only_moved_are_copied_by_name_where_the_connection_adapts;
                cases rows:
                    each_row_is_found_by_its_time_its_tick_and_its_distance,
                    rows_are_the_same_over_grpc;
                cases taps:
                    each_row_of_a_state_table_is_told_with_its_number,
                    each_event_is_told_to_its_tap,
                    each_command_is_told_to_its_tap_whoever_gave_it,
                    what_a_tap_cannot_queue_is_a_counted_drop,
                    taps_of_ports_that_change_go_and_those_of_rows_stay;
                cases payloads:
                    every_kind_of_payload_comes_back_as_it_went,
                    json_that_does_not_fit_its_payload_is_refused_with_the_place,
                    a_command_without_an_argument_takes_none_and_one_with_takes_one;
                matrix cases:
                    of_a_command,
                    of_a_step,
                    of_a_thread_of_its_own,
                    without_a_connection,
                    of_a_server_that_is_not_active,
                    of_arguments_outside_their_limits,
                    of_a_server_that_refuses,
                    of_a_busy_server,
                    of_a_busy_server_in_a_command,
                    of_a_full_queue,
                    of_what_was_begun_and_does_not_come_back,
                    of_what_was_begun_when_the_connection_is_cut,
                    of_what_was_begun_when_the_server_is_stopped,
                    of_what_was_begun_when_the_server_is_removed,
                    of_what_was_begun_and_panics,
                    when_the_connection_is_cut,
                    when_the_server_is_stopped,
                    when_the_server_is_removed,
                    when_the_server_fails,
                    of_commands_that_are_withdrawn;
            }
        })+
        /// The cases of every way.
        const PLAYED: &[(&str, &[&str])] = &[$((stringify!($module), $module::CASES)),+];
    };
}

conform! {
    other_thread_rust: OtherThread, Rust calls Rust;
    other_thread_cpp: OtherThread, Cpp calls Cpp;
    other_thread_linked: OtherThread, Linked calls Linked;
    same_stream_rust: SameStream, Rust calls Rust;
    same_stream_cpp: SameStream, Cpp calls Cpp;
    same_stream_linked: SameStream, Linked calls Linked;
    exec_in_rust: ExecIn, Rust calls Rust;
    exec_in_cpp: ExecIn, Cpp calls Cpp;
    exec_in_linked: ExecIn, Linked calls Linked;
    exec_out_rust: ExecOut, Rust calls Rust;
    exec_out_cpp: ExecOut, Cpp calls Cpp;
    exec_out_linked: ExecOut, Linked calls Linked;
    passive_rust: Passive, Rust calls Rust;
    passive_cpp: Passive, Cpp calls Cpp;
    passive_linked: Passive, Linked calls Linked;
    other_thread_rust_to_cpp: OtherThread, Rust calls Cpp;
    other_thread_cpp_to_rust: OtherThread, Cpp calls Rust;
    same_stream_rust_to_cpp: SameStream, Rust calls Cpp;
    same_stream_cpp_to_rust: SameStream, Cpp calls Rust;
    shared_memory_rust: SharedMemory, Rust calls Rust;
    shared_memory_cpp: SharedMemory, Cpp calls Cpp;
    shared_memory_linked: SharedMemory, Linked calls Linked;
    shared_memory_rust_to_cpp: SharedMemory, Rust calls Cpp;
    other_process_rust: OtherProcess, Rust calls Rust;
    other_process_cpp: OtherProcess, Cpp calls Cpp;
    other_process_linked: OtherProcess, Linked calls Linked;
    other_process_rust_to_cpp: OtherProcess, Rust calls Cpp;
    other_process_cpp_to_rust: OtherProcess, Cpp calls Rust;
    built_processes_rust: BuiltProcesses, Rust calls Rust;
    built_processes_cpp_to_rust: BuiltProcesses, Cpp calls Rust;
    other_process_on_grids_rust: OtherProcessOnGrids, Rust calls Rust;
    other_process_on_grids_cpp: OtherProcessOnGrids, Cpp calls Cpp;
    other_process_on_turned_grids_rust: OtherProcessOnTurnedGrids, Rust calls Rust;
    other_process_on_turned_grids_cpp: OtherProcessOnTurnedGrids, Cpp calls Cpp;
    other_process_of_free_client_rust: OtherProcessOfFreeClient, Rust calls Rust;
    other_process_of_free_server_cpp: OtherProcessOfFreeServer, Cpp calls Cpp;
    other_process_of_called_back_rust: OtherProcessOfCalledBack, Rust calls Rust;
    other_process_of_called_back_cpp: OtherProcessOfCalledBack, Cpp calls Cpp;
    other_process_of_passive_rust: OtherProcessOfPassive, Rust calls Rust;
    other_process_of_passive_cpp: OtherProcessOfPassive, Cpp calls Cpp;
}

#[test]
fn every_outcome_of_every_kind_of_command_comes_about_or_has_its_reason_why_not() {
    let holes = matrix::holes();
    assert!(holes.is_empty(), "{}", holes.join("\n"));
}

#[test]
fn every_situation_has_its_case() {
    for (way, cases) in PLAYED {
        for situation in Situation::ALL {
            let case = situation.case();
            assert!(cases.contains(&case), "{way}: {situation:?} is not played: {case} is not in the list");
        }
    }
}

#[test]
fn where_client_and_server_differ_in_language_each_is_of_its_own() {
    let (rust, cpp) = (Language::Rust, Language::Cpp);
    for (client, server) in [(rust, cpp), (cpp, rust)] {
        let languages = Languages { client, server };
        if let Some(why) = languages.missing() {
            return skip(&why);
        }
        let lab = Lab::pair(&Way { deployment: &OtherThread, languages });
        let mut made: Vec<String> = lab.graph().components.values().map(|c| c.class.full_name()).collect();
        made.sort();
        let mut expected = [format!("{}/Client", client.plugin()), format!("{}/Server", server.plugin())];
        expected.sort();
        assert_eq!(made, expected);
    }
}

/// Everything of a class but where it comes from and what is said to people.
fn class_of(lab: &Lab, language: Language, name: &str) -> String {
    let full = format!("{}/{name}", language.plugin());
    let mut class = (*lab.class(&full)).clone();
    (class.plugin, class.version, class.hash, class.doc) = Default::default();
    let text = format!("{class:#?}");
    // Docs of ports and fields stand on lines of their own.
    text.lines().filter(|line| !line.trim_start().starts_with("doc: ")).collect::<Vec<_>>().join("\n")
}

#[test]
fn the_classes_are_the_same_in_every_language() {
    let linked = Lab::new(Language::Linked);
    for language in [Language::Rust, Language::Cpp] {
        if let Some(why) = language.missing() {
            return skip(&why);
        }
        let lab = Lab::new(language);
        for name in ["Server", "Client", "Through", "Arm", "Shelf", "Probe"] {
            let (own, other) = (class_of(&linked, Language::Linked, name), class_of(&lab, language, name));
            let differs = own.lines().zip(other.lines()).position(|(a, b)| a != b);
            if let Some(at) = differs {
                let around = |text: &str| {
                    text.lines().skip(at.saturating_sub(8)).take(12).collect::<Vec<_>>().join("\n")
                };
                panic!("{name} linked:\n{}\n{language:?}:\n{}", around(&own), around(&other));
            }
            assert_eq!(own.lines().count(), other.lines().count(), "{name} in {language:?}");
        }
    }
}
