//! A thousand sessions of one address, one after the other.

use crate::client::{Server, Session, config, frame, hello, in_time, is_served, upgrade};
use server::ServerConfig;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpSocket, TcpStream};
use tokio::task::JoinSet;

/// Sessions that may be open.
const PLACES: usize = 16;

/// Clients of the storm, and the sessions that each of them begins.
const CLIENTS: usize = 16;
const TIMES: usize = 64;

async fn connect_from(server: &Server, network: u8) -> TcpStream {
    let socket = TcpSocket::new_v4().unwrap();
    socket.bind(([127, 0, 0, network], 0).into()).unwrap();
    socket.connect(server.address).await.unwrap()
}

/// The sessions that an address gets while it holds them all.
async fn places_of(server: &Server, network: u8) -> usize {
    let mut held = Vec::new();
    loop {
        let mut stream = connect_from(server, network).await;
        if upgrade(&mut stream).await != 101 {
            return held.len();
        }
        held.push(stream);
    }
}

#[tokio::test]
async fn a_storm_of_one_address_takes_no_place_of_others_and_leaves_none_taken() {
    let server = Server::start(ServerConfig { max_sessions: PLACES, ..config() }).await;
    let places = places_of(&server, 2).await;
    assert_eq!(places, PLACES / 2);
    server.is_empty().await;
    let before = server.ended(&["closed", "read_failed", "write_failed"]).await;

    let mut open = Session::over(connect_from(&server, 3).await).await;
    let mut storm = JoinSet::new();
    for _ in 0..CLIENTS {
        let address = server.address;
        storm.spawn(async move {
            let mut begun = 0;
            while begun < TIMES {
                let socket = TcpSocket::new_v4().unwrap();
                socket.bind(([127, 0, 0, 2], 0).into()).unwrap();
                let mut stream = socket.connect(address).await.unwrap();
                match upgrade(&mut stream).await {
                    101 => {
                        stream.write_all(&frame(&hello())).await.unwrap();
                        begun += 1;
                    }
                    // Its address has all of its places.
                    503 => {}
                    other => panic!("status {other}"),
                }
            }
        });
    }
    // Others in the storm: the open session, and new ones of another address.
    let mut new = 0;
    let in_storm = async {
        while !storm.is_empty() {
            is_served(&mut open).await;
            is_served(&mut Session::over(connect_from(&server, 4).await).await).await;
            new += 1;
            while let Some(ended) = storm.try_join_next() {
                ended.unwrap();
            }
        }
    };
    in_time(in_storm).await;
    drop(open);
    server.is_empty().await;
    let ended = server.ended(&["closed", "read_failed", "write_failed"]).await - before;
    assert_eq!(ended, (CLIENTS * TIMES) as u64 + new + 1);
    assert_eq!(places_of(&server, 2).await, places);
    server.stop().await;
}
