//! Streams: untyped ends, layouts adapted by name, frames passed on, a failed filter that is bypassed.

use serde_json::{Value, json};
use trocar_model::{Change, ConnectOptions, Queue, Refusal};
use trocar_plugin_api::abi::*;

use super::script::*;
use super::world::*;

fn outputs(types: &[(&str, Value)]) -> Value {
    json!({"outputs": types.iter().map(|(n, t)| json!({"name": n, "type": t})).collect::<Vec<_>>()})
}

fn inputs(types: &[(&str, Value)]) -> Value {
    json!({"inputs": types.iter().map(|(n, t)| json!({"name": n, "type": t})).collect::<Vec<_>>()})
}

fn plain(name: &str) -> Value {
    json!({"plain": {"ref": name}})
}

fn frames() -> Value {
    json!({"frame": "u64", "format": "image", "max_bytes": 64})
}

fn bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_ne_bytes()).collect()
}

#[test]
fn an_untyped_input_takes_the_type_of_whatever_it_is_connected_to() {
    let world = World::new("any-in");
    let source = outputs(&[("ab", plain("Ab")), ("video", frames())]);
    let source = world.active("source", &source, on_signal(), Script::default());
    let sink = world.active("sink", &inputs(&[("any", json!("any"))]), on_signal(), Script::default());
    assert_eq!(sink.described(1, 0), Value::Null);
    let connection = world.connect("sink/any", "source/ab");
    let described = sink.described(1, 0);
    assert_eq!(described["plain"]["ref"], "Ab");
    assert_eq!(described["types"][0]["fields"][0]["unit"], "N");
    assert_eq!(source.write(0, &bytes(&[1.0, 2.0])), EXECUTED);
    assert_eq!(sink.next(0, 16).unwrap().header, bytes(&[1.0, 2.0]));
    world.cut(&connection);
    assert_eq!(sink.described(1, 0), Value::Null);
    world.connect("sink/any", "source/video");
    assert_eq!(sink.described(1, 0)["format"], "image");
    assert_eq!(source.frame(1, 9, b"pixels"), EXECUTED);
    let shown = sink.next(0, 8).unwrap();
    assert_eq!((shown.bytes.as_slice(), shown.header[0]), (&b"pixels"[..], 9));
}

#[test]
fn no_two_connections_of_an_input_are_told_apart_by_the_same_number() {
    let world = World::new("serial");
    let source = outputs(&[("ab", plain("Ab")), ("ba", plain("Ba"))]);
    let source = world.active("source", &source, on_signal(), Script::default());
    let sink = world.active("sink", &inputs(&[("any", json!("any"))]), on_signal(), Script::default());
    let mut seen = std::collections::BTreeSet::new();
    // Memory of a removed connection is used again for a later one, sooner or later.
    for round in 0..200 {
        let (output, name, len) = if round % 2 == 0 { (0, "source/ab", 2) } else { (1, "source/ba", 3) };
        let connection = world.connect("sink/any", name);
        assert_eq!(source.write(output, &bytes(&[1.0, 2.0, 3.0][..len])), EXECUTED);
        let (_, token) = sink.next_with(0, 8, |view| view.token).expect("a sample has come");
        assert!(seen.insert(token), "round {round}: another connection was {token}, too");
        world.cut(&connection);
        // The input shows no more samples of it, and lets it go.
        assert!(sink.next(0, 16).is_none());
    }
}

#[test]
fn an_untyped_output_takes_the_type_of_its_first_connection_and_gives_it_back_with_the_last() {
    let world = World::new("any-out");
    let player = world.active("player", &outputs(&[("any", json!("any"))]), on_signal(), Script::default());
    let typed = inputs(&[("ab", plain("Ab")), ("ba", plain("Ba")), ("any", json!("any"))]);
    let sink = world.active("sink", &typed, on_signal(), Script::default());
    assert_eq!(player.write(0, &[0; 16]), UNBOUND, "it has no type and no size yet");
    let connect = |client: &str| {
        let connection = world.connection(client, "player/any", ConnectOptions::default());
        world.apply(Change::Connect { connection: connection.clone() }).map(|_| connection)
    };
    let refused = connect("sink/any").unwrap_err();
    assert!(matches!(&refused, Refusal::TypeMismatch { difference, .. } if difference.contains("neither")));
    let first = connect("sink/ab").unwrap();
    assert_eq!(player.described(0, 0)["plain"]["ref"], "Ab");
    let refused = connect("sink/ba").unwrap_err();
    assert!(
        matches!(&refused, Refusal::TypeMismatch { difference, .. } if difference.contains("first connection"))
    );
    assert_eq!(player.write(0, &bytes(&[3.0, 4.0])), EXECUTED);
    assert_eq!(sink.next(0, 16).unwrap().header, bytes(&[3.0, 4.0]));
    world.cut(&first);
    assert_eq!(player.described(0, 0), Value::Null);
    connect("sink/ba").unwrap();
    assert_eq!(player.described(0, 0)["plain"]["ref"], "Ba");
    assert_eq!(player.write(0, &bytes(&[1.0, 2.0, 3.0])), EXECUTED);
    assert_eq!(sink.next(1, 24).unwrap().header, bytes(&[1.0, 2.0, 3.0]));
}

#[test]
fn an_untyped_pair_passes_plain_samples_and_frames_on() {
    let world = World::new("pass-on");
    let source = outputs(&[("ab", plain("Ab")), ("video", frames())]);
    let source = world.active("source", &source, on_signal(), Script::default());
    let relay =
        json!({"inputs": [{"name": "in", "type": "any"}], "outputs": [{"name": "out", "type": "any"}]});
    let relay = world.active("relay", &relay, on_signal(), Script::default());
    let sink = inputs(&[("ab", plain("Ab")), ("video", frames())]);
    let sink = world.active("sink", &sink, on_signal(), Script::default());
    let (a, b) = (world.connect("relay/in", "source/ab"), world.connect("sink/ab", "relay/out"));
    source.write(0, &bytes(&[5.0, 6.0]));
    let (_, outcome) = relay.next_with(0, 16, |view| relay.forward(0, view)).unwrap();
    assert_eq!(outcome, EXECUTED);
    assert_eq!(sink.next(0, 16).unwrap().header, bytes(&[5.0, 6.0]));
    world.cut(&b);
    world.cut(&a);
    world.connect("relay/in", "source/video");
    world.connect("sink/video", "relay/out");
    source.frame(1, 1, b"frame");
    let (seen, outcome) = relay.next_with(0, 8, |view| relay.forward(0, view)).unwrap();
    assert_eq!(outcome, EXECUTED);
    assert!(!seen.writable, "somebody else has it, too");
    let shown = sink.next(1, 8).unwrap();
    assert_eq!(
        (shown.address, shown.bytes.as_slice()),
        (seen.address, &b"frame"[..]),
        "not a byte was copied"
    );
    assert!(shown.writable, "the relay has given it back: one owner is left");
}

#[test]
fn an_untyped_function_binds_to_any_command_and_is_told_which() {
    let world = World::new("any-fn");
    let class = json!({"required": [{"name": "peer", "functions": [{"name": "twice", "any": true}]}]});
    let client = world.active("client", &class, on_signal(), Script::default());
    world.active("server", &super::commands::server(), passive(), super::commands::obeys());
    assert_eq!(client.described(2, 0), Value::Null);
    let connection = world.connect("client/peer", "server/ctl");
    let described = client.described(2, 0);
    assert_eq!((&described["kind"], &described["arg"]["type"]), (&json!("write_return"), &json!("u64")));
    assert_eq!(client.ask(0, 6).ret, 12);
    world.cut(&connection);
    assert_eq!(client.described(2, 0), Value::Null);
}

#[test]
fn another_layout_is_copied_by_name_where_the_connection_allows_it() {
    let world = World::new("adapt");
    let source = world.active("source", &outputs(&[("ba", plain("Ba"))]), on_signal(), Script::default());
    let sink = world.active("sink", &inputs(&[("ab", plain("Ab"))]), on_signal(), Script::default());
    let connect = |adapt| {
        let queue = Some(Queue::Fifo { depth: 4, drop_oldest: false });
        let options = ConnectOptions { adapt, queue, ..ConnectOptions::default() };
        let connection = world.connection("sink/ab", "source/ba", options);
        world.apply(Change::Connect { connection })
    };
    assert!(matches!(connect(false), Err(Refusal::TypeMismatch { .. })));
    connect(true).unwrap();
    // Fields b, c, a in the source; a, b in the sink.
    source.write(0, &bytes(&[2.0, 9.0, 1.0]));
    source.write(0, &bytes(&[4.0, 9.0, 3.0]));
    let (first, second) = (sink.next(0, 16).unwrap(), sink.next(0, 16).unwrap());
    assert_eq!((first.header, first.seq), (bytes(&[1.0, 2.0]), 1));
    assert_eq!((second.header, second.seq), (bytes(&[3.0, 4.0]), 2));
}

#[test]
fn a_filter_that_failed_is_passed_by_without_a_copy() {
    let world = World::new("bypass");
    let source = world.active("source", &outputs(&[("video", frames())]), on_signal(), Script::default());
    let filter = json!({"inputs": [{"name": "in", "type": frames()}],
        "outputs": [{"name": "mean", "type": plain("Ab")}, {"name": "out", "type": frames()}]});
    // A thread of its own would look at the frame beside the test.
    world.active("filter", &filter, passive(), Script::default());
    let sink = world.active("sink", &inputs(&[("video", frames())]), on_signal(), Script::default());
    world.connect("filter/in", "source/video");
    world.connect("sink/video", "filter/out");
    source.frame(0, 3, b"picture");
    let instance = world.instance("filter");
    instance.bypass(&mut instance.object.try_enter().unwrap());
    let shown = sink.next(0, 8).unwrap();
    assert_eq!((shown.bytes.as_slice(), shown.header[0]), (&b"picture"[..], 3));
    assert!(shown.writable, "the filter keeps no hold of it");
    instance.bypass(&mut instance.object.try_enter().unwrap());
    assert_eq!(sink.next(0, 8), None, "nothing is passed on twice");
}
