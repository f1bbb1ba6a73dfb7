//! Views: selection, order, settling, prefetch, limits.

use crate::pair::{Pair, next_request, offer, refusals, send, view, welcomed};
use bytes::Bytes;
use protocol::client::Event;
use protocol::message::{ClientMessage, RefusalReason};
use protocol::server::ServerSession;
use protocol::view::View;
use protocol::{DataFrame, control, limits};
use std::collections::HashSet;

#[test]
fn a_view_is_delivered_whole_once_and_settled() {
    let mut pair = Pair::new(8);
    pair.client.set_view(view(7, 1000));
    pair.run(usize::MAX);
    assert!(matches!(pair.events[0], Event::Welcome(_)));
    let keys = pair.chunk_keys();
    let unique: HashSet<_> = keys.iter().collect();
    assert_eq!(unique.len(), keys.len());
    assert_eq!(pair.settled(), [(7, keys.len() as u32)]);
    assert!(keys.len() > 16, "several windows were needed: {}", keys.len());
}

#[test]
fn coarse_chunks_come_before_their_children() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 1000));
    pair.run(usize::MAX);
    let keys = pair.chunk_keys();
    for (index, key) in keys.iter().enumerate() {
        let parent = key.parent().unwrap();
        assert!(keys[index..].iter().all(|later| *later != parent), "{parent} came after its child {key}");
    }
}

#[test]
fn the_same_view_again_sends_nothing_new_and_settles_again() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 600));
    pair.run(usize::MAX);
    let before = pair.delivered;
    pair.client.set_view(view(2, 600));
    pair.run(usize::MAX);
    assert_eq!(pair.delivered, before);
    assert_eq!(pair.settled().last().unwrap().0, 2);
}

#[test]
fn released_chunks_are_sent_again_and_held_chunks_are_not() {
    let mut pair = Pair::new(64);
    pair.client.set_view(view(1, 600));
    pair.run(usize::MAX);
    let keys = pair.chunk_keys();
    pair.client.release(&keys[..3]);
    pair.client.set_view(view(2, 600));
    pair.run(usize::MAX);
    assert_eq!(pair.delivered, keys.len() + 3);

    let mut resumed = Pair::new(64);
    resumed.client.holding(&keys);
    resumed.client.set_view(view(1, 600));
    resumed.run(usize::MAX);
    assert_eq!((resumed.delivered, resumed.settled()), (0, vec![(1, keys.len() as u32)]));
}

/// The control is a chunk that was never sent.
#[test]
fn a_chunk_does_not_age_while_the_client_holds_it() {
    let mut server = welcomed(limits::MAX_CREDITS);
    send(&mut server, &ClientMessage::View(view(1, 300)));
    let first: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    let (unsent, sent) = first.split_first().unwrap();
    sent.iter().for_each(|request| server.deliver(*request, Bytes::from_static(b"chunk")));
    (2..=9).for_each(|id| send(&mut server, &ClientMessage::View(view(id, 300))));
    let released: Vec<_> = sent.iter().map(|request| request.key.into()).collect();
    send(&mut server, &ClientMessage::Release { keys: released });
    send(&mut server, &ClientMessage::View(view(10, 300)));
    server.fail(*unsent, RefusalReason::Failed, "");
    send(&mut server, &ClientMessage::View(view(11, 300)));
    let again: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    assert_eq!(again.len(), first.len());
    for before in &first {
        let now = again.iter().find(|request| request.key == before.key).unwrap();
        // The 10 views before this one; views 9 and 10, at whose ends it was released.
        let age = if before.key == unsent.key { 10 } else { 2 };
        assert_eq!(now.priority, before.priority / 16 * (16 + age), "{}", now.key);
    }
}

#[test]
fn an_invalid_view_is_refused_and_the_session_continues() {
    let mut pair = Pair::new(64);
    pair.client.set_view(View { fov_mdeg: 0, ..view(3, 600) });
    pair.client.set_view(View { distance_m: u32::MAX, ..view(4, 600) });
    pair.client.set_view(view(5, 600));
    pair.run(usize::MAX);
    let refused =
        |event: &&Event| matches!(event, Event::Refused(r) if r.reason == RefusalReason::InvalidView);
    assert_eq!(pair.events.iter().filter(refused).count(), 2);
    assert_eq!(pair.settled()[0].0, 5);
}

#[test]
fn chunks_that_only_a_replaced_view_needed_are_stale() {
    let mut server = welcomed(8);
    send(&mut server, &ClientMessage::View(view(1, 300)));
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    assert_eq!(in_flight.len(), 8);
    // The same eye again: all chunks are still needed.
    send(&mut server, &ClientMessage::View(view(2, 300)));
    assert!(server.take_stale().is_empty());
    send(&mut server, &ClientMessage::View(View { eye: [1 << 29, 25_600, 1 << 29], ..view(3, 300) }));
    let stale: HashSet<_> = server.take_stale().into_iter().collect();
    assert_eq!(stale, in_flight.iter().map(|request| request.key).collect());
}

#[test]
fn a_moving_view_prefetches_after_it_is_settled() {
    let moving = |id, metres: i32| View {
        eye: [metres * 256, 25_600, 0],
        velocity: [150 * 256, 0, 0],
        ..view(id, 600)
    };
    let mut pair = Pair::new(64);
    pair.client.set_view(moving(1, 0));
    pair.run(usize::MAX);
    let (_, needed) = pair.settled()[0];
    let settled_at = pair.events.iter().position(|event| matches!(event, Event::Settled(_))).unwrap();
    let before =
        pair.events[..settled_at].iter().filter(|event| matches!(event, Event::Chunk { .. })).count();
    assert_eq!(before, needed as usize);
    assert!(pair.delivered > before, "no chunk was prefetched");
    // Two seconds later the client holds all chunks.
    let sent = pair.delivered;
    pair.client.set_view(View { velocity: [0; 3], ..moving(2, 300) });
    pair.run(usize::MAX);
    assert_eq!((pair.delivered, pair.settled().len()), (sent, 2));
    // Control: without a velocity it does not.
    let mut still = Pair::new(64);
    still.client.set_view(View { velocity: [0; 3], ..moving(1, 0) });
    still.run(usize::MAX);
    let sent = still.delivered;
    still.client.set_view(View { velocity: [0; 3], ..moving(2, 300) });
    still.run(usize::MAX);
    assert!(still.delivered > sent);
}

#[test]
fn a_prefetched_chunk_is_no_next_chunk_before_the_view_is_settled() {
    let mut server = welcomed(limits::MAX_CREDITS);
    send(&mut server, &ClientMessage::View(View { velocity: [150 * 256, 0, 0], ..view(1, 600) }));
    let in_flight: Vec<_> = std::iter::from_fn(|| next_request(&mut server)).collect();
    assert!(!server.has_next_chunk(), "all chunks of the view are in flight");
    in_flight.into_iter().for_each(|request| server.deliver(request, Bytes::from_static(b"chunk")));
    assert!(server.has_next_chunk(), "the view is settled");
}

#[test]
fn a_failed_selection_refuses_its_view_and_lets_the_next_one_through() {
    let mut server = welcomed(64);
    send(&mut server, &ClientMessage::View(view(1, 300)));
    let next = control::encode(&ClientMessage::View(view(2, 300))).unwrap();
    server.receive(DataFrame::Binary(&next)).unwrap();
    drop(server.take_view().unwrap());
    server.fail_view("it failed");
    assert_eq!(refusals(&mut server), [(2, RefusalReason::Failed)]);
    assert_eq!(server.view().map(|view| view.id), Some(1));
    send(&mut server, &ClientMessage::View(view(3, 300)));
    assert_eq!(server.view().map(|view| view.id), Some(3));
    // Nothing is selected, so nothing fails.
    server.fail_view("it failed");
    assert_eq!(refusals(&mut server), []);
}

#[test]
fn only_the_newest_view_is_selected_one_at_a_time() {
    let mut server = welcomed(64);
    let receive = |server: &mut ServerSession, id| {
        let message = ClientMessage::View(view(id, 300));
        server.receive(DataFrame::Binary(&control::encode(&message).unwrap())).unwrap();
    };
    (1..=1000).for_each(|id| receive(&mut server, id));
    let selection = server.take_view().unwrap();
    assert_eq!(selection.view().id, 1000);
    (1001..=1003).for_each(|id| receive(&mut server, id));
    assert!(server.take_view().is_none() && !server.has_waiting_view(), "one selection at a time");
    server.apply_view(selection);
    assert_eq!(server.view().map(|view| view.id), Some(1000));
    assert!(server.has_waiting_view());
    let selection = server.take_view().unwrap();
    assert_eq!(selection.view().id, 1003);
    server.apply_view(selection);
    assert!(server.take_view().is_none());
    let counts = server.counts();
    assert_eq!((counts.views, counts.superseded_views), (2, 1001));
}

#[test]
fn a_selection_in_steps_equals_one_in_a_single_step() {
    let moving = View { velocity: [150 * 256, 0, 0], ..view(1, 2000) };
    let mut results = Vec::new();
    for chunks in [1, 50, usize::MAX] {
        let mut server = welcomed(4096);
        server.receive(DataFrame::Binary(&control::encode(&ClientMessage::View(moving)).unwrap())).unwrap();
        let mut selection = server.take_view().unwrap();
        let mut steps = 1;
        while !selection.step(&offer().land, chunks) {
            steps += 1;
        }
        assert!(chunks > 50 || steps > 10, "{steps} steps");
        server.apply_view(selection);
        results.push(std::iter::from_fn(|| next_request(&mut server)).collect::<Vec<_>>());
    }
    assert!(results[0].len() > 30 && results[0] == results[1] && results[1] == results[2]);
}

#[test]
fn a_view_of_too_many_chunks_is_refused_without_effect() {
    let largest = View { viewport: [limits::MAX_VIEWPORT; 2], tolerance_q4: 1, ..view(2, 65_536) };
    let mut server = welcomed(64);
    send(&mut server, &ClientMessage::View(view(1, 300)));
    send(&mut server, &ClientMessage::View(largest));
    assert_eq!(refusals(&mut server), [(2, RefusalReason::InvalidView)]);
    assert_eq!(server.view().map(|view| view.id), Some(1));
    // Control: views that viewers send, up to a picture of 3840 x 2160 at half a pixel and 20
    // km.
    for (distance_m, viewport, tolerance_q4) in [(8000, [1920, 1080], 16), (20_000, [3840, 2160], 8)] {
        send(&mut server, &ClientMessage::View(View { viewport, tolerance_q4, ..view(3, distance_m) }));
    }
    assert_eq!((refusals(&mut server), server.counts().views), (vec![], 3));
}

#[test]
fn extreme_view_fields_are_refused_or_served_without_panic() {
    for extreme in [i32::MIN, -1, 0, 1, i32::MAX] {
        let mut server = welcomed(4);
        for eye in [[0; 3], [1 << 30, extreme, -(1 << 30)], [extreme; 3]] {
            send(
                &mut server,
                &ClientMessage::View(View {
                    eye,
                    velocity: [extreme; 3],
                    yaw_mdeg: extreme,
                    pitch_mdeg: extreme,
                    ..view(1, 65_536)
                }),
            );
        }
        while next_request(&mut server).is_some() {}
        let counts = server.counts();
        assert_eq!(counts.views + counts.refusals[RefusalReason::InvalidView.index()], 3);
    }
}
