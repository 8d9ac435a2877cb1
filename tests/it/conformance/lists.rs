//! The cases and the ways of the suites `conformance` and `conformance_cross`, each written down once.
//!
//! Invariant: each way says for each class of cases which of the two suites plays it, so that no case can be
//! lost between them and none is played twice.

/// Hands the cases to the macro `$then`, by topic and class.
///
/// A case is independent only when its own line says why. The line of a topic says why the others of it
/// depend on the way; a case that is in doubt depends on it.
macro_rules! cases {
    ($then:ident $args:tt) => {
        $then! { $args
            // The carrier brings each command, answers its caller, and decides what may wait or run inline.
            // A read from outside sees rows that the client's thread publishes where it runs the server.
            cases commands {
                First {
                    every_kind_that_is_sent_arrives_once,
                    every_kind_that_is_called_gives_its_result,
                    commands_of_one_client_keep_their_order,
                    a_read_is_answered_from_the_published_row_with_its_stamp,
                }
                Second {
                    every_kind_that_is_sent_from_a_step_arrives_once,
                    a_call_from_a_step_runs_inline_or_would_block,
                    several_threads_of_a_client_use_one_function_at_once,
                    a_read_waits_for_nobody,
                }
            }
            // The carrier refuses, queues, drops and times calls, on either side of the connection.
            cases outcomes {
                Independent {
                    // The slot of a function answers this when no connection has filled it.
                    nothing_connected_is_unbound,
                }
                First {
                    a_server_that_is_not_active_says_so_and_can_still_be_read,
                    a_command_that_refuses_has_failed_with_its_own_sentence,
                    a_full_queue_gives_up_its_oldest_where_the_command_says_so,
                    a_call_that_was_not_begun_by_its_deadline_never_runs,
                    a_goal_that_was_sent_and_waited_longer_than_its_connection_allows_never_runs,
                    a_command_that_was_sent_with_a_deadline_of_its_own_never_runs_after_it,
                    a_call_without_any_deadline_ends_all_the_same,
                    a_command_that_panics_has_failed_and_puts_only_its_server_in_fault,
                }
                Second {
                    an_argument_outside_its_limits_never_reaches_the_server,
                    a_full_queue_refuses_and_keeps_what_it_has,
                    the_latest_wins_where_the_command_says_so,
                    a_call_without_a_deadline_has_that_of_its_connection,
                    a_call_that_was_begun_by_its_deadline_may_still_run,
                }
            }
            // Events go back over the carrier. The thread that emits decides when anybody hears, outside as
            // well.
            cases events {
                Independent {
                    // The GCM answers whoever waits, from the state of the server alone; the client has no
                    // part.
                    whoever_waits_for_an_event_is_told_when_it_does_not_come,
                }
                First {
                    an_event_back_into_a_stepping_client_waits_for_the_end_of_the_step,
                    every_observer_hears_every_event,
                    from_outside_one_can_wait_for_an_event,
                    a_client_that_is_disconnected_hears_nothing_more,
                    a_direct_handler_runs_inside_emit_where_both_share_a_thread,
                    a_client_that_was_reset_hears_again,
                }
                Second {
                    events_arrive_each_once_and_in_order,
                    events_that_find_a_full_queue_are_counted_and_told_to_who_emits,
                    events_are_followed_from_outside_in_order,
                    events_of_a_command_from_outside_wake_the_client,
                    a_direct_handler_of_a_client_that_is_busy_waits_like_any_other,
                }
            }
            // Samples lie in a queue of one process or in memory that two map, and each counts gaps for
            // itself.
            cases streams {
                First {
                    the_latest_value_is_shown_again_and_is_fresh_once,
                    a_full_queue_of_samples_drops_the_newest_where_asked,
                    nothing_is_lost_without_being_counted_while_both_run,
                    a_sample_older_than_the_connection_allows_is_stale,
                    samples_of_a_clock_that_is_ahead_or_behind_are_stale_when_health_says_so,
                    a_cut_stream_shows_nothing_and_a_new_one_starts_afresh,
                }
                Second {
                    a_full_queue_of_samples_drops_its_oldest_and_the_gap_says_how_many,
                    an_input_s_own_depth_counts_where_the_connection_names_none,
                    one_output_feeds_many_inputs_each_at_its_own_pace,
                    a_slow_consumer_misses_what_its_queue_cannot_hold_and_knows_how_much,
                    an_input_is_rewired_in_one_request,
                }
            }
            // Frames pass in memory of one process or in memory that two map, where only their maker may
            // write.
            cases frames {
                Independent {
                    // The team of the stream works inside one process; the client only takes what comes out
                    // of it.
                    the_threads_of_a_stream_work_on_slices_at_the_same_time,
                }
                First {
                    a_frame_arrives_where_it_was_made,
                    a_filter_changes_a_frame_in_place,
                    a_queue_that_keeps_its_oldest_frames_takes_no_more_before_their_pool_is_empty,
                    a_branch_that_takes_no_frames_costs_the_others_none,
                    a_filter_that_failed_stops_its_branch_and_no_other,
                }
                Second {
                    a_frame_that_two_have_is_nobody_s_to_change,
                    a_queue_of_frames_gives_up_its_oldest_before_their_pool_is_empty,
                    an_exhausted_pool_is_a_counted_drop,
                    a_filter_that_failed_is_bypassed_where_its_stream_says_so,
                }
            }
            // The thread that runs a component carries out its verbs and notices what fails or does not come
            // back. A peer that is lost is noticed in the process of whoever loses it.
            cases lifecycle {
                Independent {
                    // The model refuses it, from the graph.
                    start_is_refused_while_something_required_is_not_connected,
                    // The GCM answers whoever waits, from the states it is told.
                    one_can_wait_for_a_state_and_is_told_when_it_cannot_come,
                }
                First {
                    an_actuator_that_loses_its_peer_is_made_safe_and_stops,
                    an_actuator_whose_source_falls_silent_has_stale_input_and_goes_on,
                    stop_makes_safe_and_resume_keeps_what_start_makes_anew,
                    a_step_that_panics_is_a_fault_with_its_sentence,
                    everything_is_counted_from_a_reset_anew,
                }
                Second {
                    an_actuator_whose_peer_is_removed_is_made_safe_and_stops,
                    a_disconnect_changes_no_other_component_s_state,
                    a_step_that_fails_is_a_fault_with_its_sentence,
                    a_command_that_does_not_come_back_is_unresponsive_and_the_host_goes_on,
                }
            }
            // The carrier takes calls back from its queue when an end of it goes, and counts what nobody ran.
            cases loss {
                First {
                    a_call_whose_connection_is_cut_has_lost_its_peer,
                    a_call_whose_server_is_stopped_finds_it_not_active,
                    a_client_that_is_removed_while_its_call_waits_is_answered_and_the_call_never_runs,
                }
                Second {
                    a_call_whose_server_is_removed_is_told_so_and_never_runs,
                    a_call_that_waits_in_a_server_that_goes_into_fault_is_answered,
                    rewiring_while_calls_go_on_loses_none_and_answers_each,
                }
            }
            // A live setting is a job between the cycles of the thread that also carries the client's calls.
            cases configuring {
                Independent {
                    // The model refuses it, from the class and the state.
                    any_other_setting_of_a_running_component_is_refused,
                    // The model refuses it, from the class.
                    a_value_outside_its_limits_is_refused_whole,
                    // The GCM keeps settings in the graph, and a Reset makes the instance anew from them.
                    a_configuration_survives_a_reset,
                }
                First {
                    a_live_setting_changes_while_the_component_runs,
                }
                Second {
                    settings_change_under_load_and_each_answer_is_of_one_of_them,
                }
            }
            // Connections to ports that change are cut and made again by the carrier, and calls are under
            // way.
            cases changing {
                Independent {
                    // The LCM refuses a description before it touches a port; nothing is connected.
                    ports_that_contradict_each_other_are_refused_and_the_old_ones_stay,
                }
                First {
                    a_configuration_makes_ports_that_answer_each_for_itself,
                    a_component_changes_its_ports_itself,
                    calls_of_ports_that_come_and_go_are_each_answered_and_none_runs_twice,
                }
                Second {
                    what_stays_keeps_its_connections_and_what_goes_loses_them,
                    ports_of_a_configuration_survive_a_reset,
                }
            }
            // Each carrier passes bytes of any type, holds frames, and copies fields by name by itself.
            cases untyped {
                First {
                    an_untyped_input_takes_samples_and_frames_as_they_are,
                    frames_are_held_as_long_as_enough_stay_free_for_their_source,
                    two_untyped_ends_pass_what_a_third_one_made_of_the_output,
                    fields_that_only_moved_are_copied_by_name_where_the_connection_adapts,
                }
                Second {
                    a_frame_that_an_untyped_input_keeps_stays_whatever_becomes_of_the_input,
                    an_untyped_output_gives_what_its_peer_takes_and_nothing_of_another_size,
                    an_untyped_function_calls_what_it_is_connected_to_and_nothing_of_another_size,
                }
            }
            // The thread of the server decides which rows there are, and for how long.
            cases rows {
                Independent {
                    // The gRPC edge hands on what the table answers; the client has no part.
                    rows_are_the_same_over_grpc,
                }
                Second {
                    each_row_is_found_by_its_time_its_tick_and_its_distance,
                }
            }
            // Taps reach the client over the carrier, as samples do.
            cases taps {
                First {
                    each_row_of_a_state_table_is_told_with_its_number,
                    each_command_is_told_to_its_tap_whoever_gave_it,
                    taps_of_ports_that_change_go_and_those_of_rows_stay,
                }
                Second {
                    each_event_is_told_to_its_tap,
                    what_a_tap_cannot_queue_is_a_counted_drop,
                }
            }
            cases payloads {
                Independent {
                    // The model turns JSON from outside into bytes and back, by the type alone.
                    every_kind_of_payload_comes_back_as_it_went,
                    // The model refuses it, by the type alone.
                    json_that_does_not_fit_its_payload_is_refused_with_the_place,
                    // The model refuses it, by the declaration of the command.
                    a_command_without_an_argument_takes_none_and_one_with_takes_one,
                }
            }
            // A situation is played by what the reach of a call makes of it.
            matrix cases {
                Independent {
                    // The slot of a function answers this when no connection has filled it.
                    without_a_connection,
                }
                First {
                    of_a_command,
                    of_a_thread_of_its_own,
                    of_arguments_outside_their_limits,
                    of_a_busy_server,
                    of_a_full_queue,
                    of_what_was_begun_when_the_connection_is_cut,
                    of_what_was_begun_when_the_server_is_removed,
                    when_the_connection_is_cut,
                    when_the_server_is_removed,
                    of_commands_that_are_withdrawn,
                }
                Second {
                    of_a_step,
                    of_a_server_that_is_not_active,
                    of_a_server_that_refuses,
                    of_a_busy_server_in_a_command,
                    of_what_was_begun_and_does_not_come_back,
                    of_what_was_begun_when_the_server_is_stopped,
                    of_what_was_begun_and_panics,
                    when_the_server_is_stopped,
                    when_the_server_fails,
                }
            }
        }
    };
}

/// Hands the ways to the macro `$then`: deployment, languages, and the suite that plays the cases which are
/// independent, of the first half, and of the second half.
macro_rules! ways {
    ($then:ident $args:tt) => {
        $then! { $args
            // Everything is played where each has a thread of its own, for each language.
            other_thread_rust: OtherThread, Rust calls Rust: Cross Gate Gate;
            other_thread_cpp: OtherThread, Cpp calls Cpp: Gate Gate Gate;
            other_thread_linked: OtherThread, Linked calls Linked: Gate Gate Gate;
            other_thread_rust_to_cpp: OtherThread, Rust calls Cpp: Cross Cross Cross;
            other_thread_cpp_to_rust: OtherThread, Cpp calls Rust: Cross Cross Cross;
            // Both in one thread: three arrangements, and calls between languages without a queue.
            same_stream_rust: SameStream, Rust calls Rust: Cross Cross Cross;
            same_stream_cpp: SameStream, Cpp calls Cpp: Cross Cross Cross;
            same_stream_linked: SameStream, Linked calls Linked: Cross Gate Gate;
            same_stream_rust_to_cpp: SameStream, Rust calls Cpp: Cross Gate Cross;
            same_stream_cpp_to_rust: SameStream, Cpp calls Rust: Cross Cross Gate;
            exec_in_rust: ExecIn, Rust calls Rust: Cross Cross Cross;
            exec_in_cpp: ExecIn, Cpp calls Cpp: Cross Cross Gate;
            exec_in_linked: ExecIn, Linked calls Linked: Cross Gate Cross;
            exec_out_rust: ExecOut, Rust calls Rust: Cross Cross Cross;
            exec_out_cpp: ExecOut, Cpp calls Cpp: Cross Gate Cross;
            exec_out_linked: ExecOut, Linked calls Linked: Cross Cross Gate;
            // No other deployment has this reach, so both halves meet either language here.
            passive_rust: Passive, Rust calls Rust: Cross Cross Cross;
            passive_cpp: Passive, Cpp calls Cpp: Cross Gate Gate;
            passive_linked: Passive, Linked calls Linked: Cross Gate Gate;
            // Memory that both ends map, in one process.
            shared_memory_rust: SharedMemory, Rust calls Rust: Cross Cross Cross;
            shared_memory_cpp: SharedMemory, Cpp calls Cpp: Cross Cross Gate;
            shared_memory_linked: SharedMemory, Linked calls Linked: Cross Gate Gate;
            shared_memory_rust_to_cpp: SharedMemory, Rust calls Cpp: Cross Gate Cross;
            // Two hosts of the test's own process. Mixed languages are the reach where reads are asked for.
            other_process_rust: OtherProcess, Rust calls Rust: Cross Cross Cross;
            other_process_cpp: OtherProcess, Cpp calls Cpp: Cross Cross Cross;
            other_process_linked: OtherProcess, Linked calls Linked: Cross Gate Gate;
            other_process_rust_to_cpp: OtherProcess, Rust calls Cpp: Cross Cross Gate;
            other_process_cpp_to_rust: OtherProcess, Cpp calls Rust: Cross Gate Cross;
            // Two hosts between which an encrypted line is, as between machines. Rows do not leave their
            // machine, so that reads are asked for in any languages.
            other_machine_rust: OtherMachine, Rust calls Rust: Cross Gate Gate;
            other_machine_cpp: OtherMachine, Cpp calls Cpp: Cross Gate Gate;
            other_machine_linked: OtherMachine, Linked calls Linked: Cross Gate Gate;
            other_machine_rust_to_cpp: OtherMachine, Rust calls Cpp: Cross Cross Gate;
            other_machine_cpp_to_rust: OtherMachine, Cpp calls Rust: Cross Gate Cross;
            // Requests reach these over gRPC. Independent cases of Rust are played here, so that they meet
            // that, too.
            built_processes_rust: BuiltProcesses, Rust calls Rust: Gate Gate Gate;
            built_processes_rust_to_cpp: BuiltProcesses, Rust calls Cpp: Cross Gate Cross;
            built_processes_cpp_to_rust: BuiltProcesses, Cpp calls Rust: Cross Cross Gate;
            // Two hosts again, by how each end is executed.
            other_process_on_grids_rust: OtherProcessOnGrids, Rust calls Rust: Cross Cross Cross;
            other_process_on_grids_cpp: OtherProcessOnGrids, Cpp calls Cpp: Cross Cross Gate;
            other_process_on_grids_linked: OtherProcessOnGrids, Linked calls Linked: Cross Gate Cross;
            other_process_on_turned_grids_rust: OtherProcessOnTurnedGrids, Rust calls Rust: Cross Cross Cross;
            other_process_on_turned_grids_cpp: OtherProcessOnTurnedGrids, Cpp calls Cpp: Cross Gate Cross;
            other_process_on_turned_grids_linked: OtherProcessOnTurnedGrids, Linked calls Linked:
                Cross Cross Gate;
            other_process_of_free_client_rust: OtherProcessOfFreeClient, Rust calls Rust: Cross Cross Cross;
            other_process_of_free_client_cpp: OtherProcessOfFreeClient, Cpp calls Cpp: Cross Cross Gate;
            other_process_of_free_client_linked: OtherProcessOfFreeClient, Linked calls Linked:
                Cross Gate Cross;
            other_process_of_free_server_cpp: OtherProcessOfFreeServer, Cpp calls Cpp: Cross Gate Cross;
            other_process_of_free_server_linked: OtherProcessOfFreeServer, Linked calls Linked:
                Cross Cross Gate;
            other_process_of_called_back_rust: OtherProcessOfCalledBack, Rust calls Rust: Cross Cross Cross;
            other_process_of_called_back_cpp: OtherProcessOfCalledBack, Cpp calls Cpp: Cross Cross Gate;
            other_process_of_called_back_linked: OtherProcessOfCalledBack, Linked calls Linked:
                Cross Gate Cross;
            other_process_of_passive_rust: OtherProcessOfPassive, Rust calls Rust: Cross Cross Cross;
            other_process_of_passive_cpp: OtherProcessOfPassive, Cpp calls Cpp: Cross Gate Cross;
            other_process_of_passive_linked: OtherProcessOfPassive, Linked calls Linked: Cross Cross Gate;
        }
    };
}
