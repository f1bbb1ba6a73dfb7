//! The handshake: versions, worlds, tokens, order.

use crate::pair::{config, offer, seed_only, view, welcome_frame};
use protocol::client::{ClientConfig, ClientSession, Event};
use protocol::message::{ClientMessage, Rejection, ServerMessage, Settled};
use protocol::server::{ServerOffer, ServerSession, TokenCheck};
use protocol::{ChunkError, CloseCode, DataFrame, PROTOCOL_VERSION, PeerFault, chunk_codec, control};
use std::sync::Arc;
use terrain::{ChunkKey, Land, WorldDigest};

#[test]
fn rejected_handshakes_name_the_values_of_both_sides() {
    let wrong = WorldDigest([9; 32]);
    let mut client = ClientSession::new(ClientConfig { digest: Some(wrong), ..config(1) });
    let mut server = ServerSession::new(offer(), 1);
    let fault = server.receive(DataFrame::Binary(&client.poll_transmit().unwrap())).unwrap_err();
    assert_eq!(fault.close_code(), CloseCode::WrongWorld);
    let seen = client.receive(DataFrame::Binary(&server.poll_transmit().unwrap())).unwrap_err();
    assert_eq!(seen, fault);
    let text = seen.to_string();
    assert!(text.contains(&wrong.to_string()) && text.contains(&offer().digest.to_string()), "{text}");

    let mut frame = control::encode(&ClientMessage::Credit { chunks: 1 }).unwrap().to_vec();
    frame[4] = 77;
    let mut server = ServerSession::new(offer(), 1);
    let fault = server.receive(DataFrame::Binary(&frame)).unwrap_err();
    assert_eq!(fault, PeerFault::Rejected(Rejection::WrongVersion { client: 77, server: PROTOCOL_VERSION }));
    let ours = format!("server {PROTOCOL_VERSION}");
    assert!(fault.to_string().contains("77") && fault.to_string().contains(&ours));
}

#[test]
fn only_the_right_token_is_accepted_where_one_is_required() {
    for (presented, admitted) in
        [(None, false), (Some("wrong"), false), (Some(""), false), (Some("secret"), true)]
    {
        let token: Arc<dyn TokenCheck> = Arc::new(String::from("secret"));
        let mut server = ServerSession::new(ServerOffer { token: Some(token), ..offer() }, 1);
        let config = ClientConfig { token: presented.map(String::from), ..config(1) };
        let hello = ClientSession::new(config).poll_transmit().unwrap();
        let result = server.receive(DataFrame::Binary(&hello));
        assert_eq!(result.is_ok(), admitted, "{presented:?}");
        assert_eq!(server.is_welcomed(), admitted);
    }
}

#[test]
fn a_client_without_a_token_does_not_learn_the_world() {
    let token: Arc<dyn TokenCheck> = Arc::new(String::from("secret"));
    let mut server = ServerSession::new(ServerOffer { token: Some(token), ..offer() }, 1);
    let config = ClientConfig { digest: Some(WorldDigest([9; 32])), ..config(1) };
    let hello = ClientSession::new(config).poll_transmit().unwrap();
    let fault = server.receive(DataFrame::Binary(&hello)).unwrap_err();
    assert_eq!(fault, PeerFault::Rejected(Rejection::Unauthorised));
}

#[test]
fn order_is_enforced_on_both_sides() {
    let mut server = ServerSession::new(offer(), 1);
    let view = control::encode(&ClientMessage::View(view(1, 600))).unwrap();
    assert!(matches!(server.receive(DataFrame::Binary(&view)), Err(PeerFault::OutOfOrder(_))));
    assert!(matches!(server.receive(DataFrame::Text), Err(PeerFault::Text)));

    let mut client = ClientSession::new(config(1));
    let settled = control::encode(&ServerMessage::Settled(Settled { view: 1, chunks: 1 })).unwrap();
    assert!(matches!(client.receive(DataFrame::Binary(&settled)), Err(PeerFault::OutOfOrder(_))));
    let chunk = chunk_codec::encode(&Land::new(1).chunk(ChunkKey::new(0, 60, 60).unwrap()), &offer().digest);
    assert!(matches!(client.receive(DataFrame::Binary(&chunk)), Err(PeerFault::OutOfOrder(_))));
    let welcome = welcome_frame();
    assert_eq!(client.world(), None);
    client.receive(DataFrame::Binary(&welcome)).unwrap();
    assert_eq!(client.world(), Some(offer().digest));
    assert!(matches!(client.receive(DataFrame::Binary(&welcome)), Err(PeerFault::OutOfOrder(_))));
    assert!(matches!(
        client.receive(DataFrame::Binary(&chunk[..40])),
        Err(PeerFault::Chunk(ChunkError::Truncated { .. }))
    ));
}

#[test]
fn a_client_with_another_generator_rejects_seed_only_delivery() {
    // The server's generator differs: its seed generates another world here.
    let (ours, theirs) = (Land::new(1).digest(), WorldDigest([0xcd; 32]));
    let welcome = |config: ClientConfig| {
        let mut client = ClientSession::new(config);
        let mut server = ServerSession::new(ServerOffer { digest: theirs, ..offer() }, 1);
        server.receive(DataFrame::Binary(&client.poll_transmit().unwrap())).unwrap();
        client.receive(DataFrame::Binary(&server.poll_transmit().unwrap()))
    };
    let fault = welcome(seed_only(1)).unwrap_err();
    assert_eq!(fault.close_code(), CloseCode::WrongWorld);
    let text = fault.to_string();
    assert!(text.contains(&ours.to_string()) && text.contains(&theirs.to_string()), "{text}");
    assert!(text.contains("use exact delivery") && text.lines().count() == 1, "{text}");
    // Control: exact delivery needs no generator.
    assert!(matches!(welcome(config(1)), Ok(Event::Welcome(_))));
}

#[test]
fn a_client_learns_when_to_reconnect_to_a_server_that_shuts_down() {
    let (mut client, mut server) = (ClientSession::new(config(1)), ServerSession::new(offer(), 1));
    server.drain(1500);
    let announced = client.receive(DataFrame::Binary(&server.poll_transmit().unwrap()));
    assert_eq!(announced, Ok(Event::Draining { reconnect_after_ms: 1500 }));
}
