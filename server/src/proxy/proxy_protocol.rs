//! The PROXY protocol, versions 1 and 2: a header with the client's address at the start of a
//! connection (HAProxy, doc/proxy-protocol.txt).
//!
//! Where it is configured it is required: a header that may be missing could be written by a
//! client.

use ppp::{v1, v2};
use std::io::{self, ErrorKind};
use std::net::IpAddr;
use tokio::io::{AsyncRead, AsyncReadExt};

/// First bytes of version 2.
const SIGNATURE_2: [u8; 12] = *b"\r\n\r\n\0\r\nQUIT\n";

/// Longest line of version 1, bytes.
const LINE: usize = 107;

/// Bytes before the addresses in version 2.
const FIXED_2: usize = 16;

/// Longest header of version 2 that is read, bytes: addresses and some extensions.
const HEADER_2: usize = 2048;

/// Reads the header, and no byte more. None for a connection that the proxy makes for itself, such
/// as a probe.
///
/// # Errors
/// The connection failed, or it begins with something else.
pub async fn read<S: AsyncRead + Unpin>(stream: &mut S) -> io::Result<Option<IpAddr>> {
    let mut bytes = vec![0; SIGNATURE_2.len()];
    stream.read_exact(&mut bytes).await?;
    if bytes == SIGNATURE_2 {
        return read_2(stream, bytes).await;
    }
    if !bytes.starts_with(b"PROXY ") {
        return Err(malformed());
    }
    // Byte by byte: what follows the line belongs to the next reader.
    while !bytes.ends_with(b"\r\n") {
        if bytes.len() == LINE {
            return Err(malformed());
        }
        bytes.push(stream.read_u8().await?);
    }
    let header = v1::Header::try_from(bytes.as_slice()).map_err(|_| malformed())?;
    Ok(match header.addresses {
        v1::Addresses::Tcp4(addresses) => Some(addresses.source_address.into()),
        v1::Addresses::Tcp6(addresses) => Some(addresses.source_address.into()),
        v1::Addresses::Unknown => None,
    })
}

async fn read_2<S: AsyncRead + Unpin>(stream: &mut S, mut bytes: Vec<u8>) -> io::Result<Option<IpAddr>> {
    bytes.resize(FIXED_2, 0);
    stream.read_exact(&mut bytes[SIGNATURE_2.len()..]).await?;
    let length = FIXED_2 + usize::from(u16::from_be_bytes([bytes[14], bytes[15]]));
    if length > HEADER_2 {
        return Err(malformed());
    }
    bytes.resize(length, 0);
    stream.read_exact(&mut bytes[FIXED_2..]).await?;
    let header = v2::Header::try_from(bytes.as_slice()).map_err(|_| malformed())?;
    Ok(match (header.command, header.addresses) {
        (v2::Command::Proxy, v2::Addresses::IPv4(addresses)) => Some(addresses.source_address.into()),
        (v2::Command::Proxy, v2::Addresses::IPv6(addresses)) => Some(addresses.source_address.into()),
        _ => None,
    })
}

fn malformed() -> io::Error {
    io::Error::new(ErrorKind::InvalidData, "no PROXY header")
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn parse(bytes: &[u8]) -> (io::Result<Option<IpAddr>>, Vec<u8>) {
        let mut stream = bytes;
        let read = read(&mut stream).await;
        (read, stream.to_vec())
    }

    fn version_2(addresses: impl Into<v2::Addresses>) -> Vec<u8> {
        let command = v2::Version::Two | v2::Command::Proxy;
        let header = v2::Builder::with_addresses(command, v2::Protocol::Stream, addresses);
        header.write_tlv(v2::Type::NoOp, &[0; 100]).unwrap().build().unwrap()
    }

    #[tokio::test]
    async fn the_address_is_read_and_the_next_byte_is_not() {
        let four =
            ("192.0.2.7:4711".parse::<std::net::SocketAddr>().unwrap(), "10.0.0.1:80".parse().unwrap());
        let six =
            ("[2001:db8::7]:4711".parse::<std::net::SocketAddr>().unwrap(), "[::1]:80".parse().unwrap());
        let mut local = version_2(four);
        local[12] = 0x20;
        for (header, client) in [
            (b"PROXY TCP4 192.0.2.7 10.0.0.1 4711 80\r\n".to_vec(), Some("192.0.2.7")),
            (b"PROXY TCP6 2001:db8::7 ::1 4711 80\r\n".to_vec(), Some("2001:db8::7")),
            (b"PROXY UNKNOWN\r\n".to_vec(), None),
            (version_2(four), Some("192.0.2.7")),
            (version_2(six), Some("2001:db8::7")),
            (local, None),
        ] {
            let (read, rest) = parse(&[&header, &b"GET /"[..]].concat()).await;
            assert_eq!(read.unwrap(), client.map(|text| text.parse().unwrap()), "{header:?}");
            assert_eq!(rest, b"GET /");
            // Every part of it is no header.
            for length in 0..header.len() {
                assert!(parse(&header[..length]).await.0.is_err(), "{length} bytes of {header:?}");
            }
        }
    }

    #[tokio::test]
    async fn other_bytes_are_rejected_after_a_bounded_number() {
        let long = [&SIGNATURE_2[..], &[0x21, 0x11, 0xff, 0xff], &[0; 70_000]].concat();
        let endless = [&b"PROXY TCP4 "[..], &[b'1'; 4000]].concat();
        for bytes in [
            &b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"[..],
            &long,
            &endless,
            &[22, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3, 9],
        ] {
            let (read, rest) = parse(bytes).await;
            assert_eq!(read.unwrap_err().kind(), ErrorKind::InvalidData);
            assert!(bytes.len() - rest.len() <= LINE);
        }
    }
}
