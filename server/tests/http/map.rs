//! Map tiles as a browser receives them.

use crate::client::Server;
use std::io::Cursor;
use terrain::{ChunkKey, Land};

const SIDE: usize = 256;

struct Image(Vec<u8>);

impl Image {
    async fn fetch(server: &Server, tile: &str) -> Self {
        let reply = server.get(&server.path(&format!("map/{tile}.png"))).await;
        assert_eq!((reply.status, reply.header("content-type")), (200, "image/png"), "{tile}");
        let mut reader = png::Decoder::new(Cursor::new(reply.body)).read_info().unwrap();
        let info = reader.info();
        assert_eq!((info.width, info.height, info.color_type), (256, 256, png::ColorType::Rgb));
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut pixels).unwrap();
        Self(pixels)
    }

    fn pixel(&self, column: usize, row: usize) -> [i32; 3] {
        std::array::from_fn(|part| i32::from(self.0[(row * SIDE + column) * 3 + part]))
    }
}

fn distance(a: [i32; 3], b: [i32; 3]) -> i32 {
    (0..3).map(|part| (a[part] - b[part]).abs()).sum()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn colours_follow_the_generated_heights() {
    let server = Server::start().await;
    let image = Image::fetch(&server, "5/0/0").await;
    // The same square from the generator: one chunk of 64 cells, 4 pixels per cell.
    let chunk = Land::new(1).chunk(ChunkKey::new(5, 0, 0).unwrap());
    let (mut sea, mut land, mut redness) = (0, 0, 0);
    for row in 0..64 {
        for column in 0..64 {
            let height_m = chunk.vertex(column, row) / 256;
            let [red, _, blue] = image.pixel(4 * column, 4 * row);
            if height_m < -10 {
                sea += 1;
                assert!(blue > red + 20, "{height_m} m at {column}, {row}: red {red}, blue {blue}");
            }
            if height_m > 15 {
                land += 1;
                // The mean, since single slopes may lie in a bluish shadow, and low land is green.
                redness += red - blue;
            }
        }
    }
    assert!(sea > 500 && land > 500 && redness / land > 10, "{sea} {land} {redness}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn neighbouring_tiles_meet_without_a_seam() {
    let server = Server::start().await;
    for level in [0, 1, 5] {
        let (west, east) = (
            Image::fetch(&server, &format!("{level}/-1/0")).await,
            Image::fetch(&server, &format!("{level}/0/0")).await,
        );
        let mean = |step: &dyn Fn(usize) -> i32| (0..SIDE).map(step).sum::<i32>() / SIDE as i32;
        let across = mean(&|row| distance(west.pixel(SIDE - 1, row), east.pixel(0, row)));
        // Between adjacent columns within the tiles.
        let within = mean(&|row| {
            (distance(west.pixel(SIDE - 2, row), west.pixel(SIDE - 1, row))
                + distance(east.pixel(0, row), east.pixel(1, row)))
                / 2
        });
        assert!(across <= within + within / 2 + 2, "level {level}: {across} across, {within} within");
        // The control: unrelated tiles have a seam.
        let wrong = mean(&|row| distance(west.pixel(SIDE - 1, row), east.pixel(0, SIDE - 1 - row)));
        assert!(
            wrong > 2 * across.max(1),
            "level {level}: {wrong} for the wrong neighbour, {across} for the right one"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn tiles_of_all_levels_and_corners_are_rendered_and_cached() {
    let server = Server::start().await;
    for tile in ["0/-32768/-32768", "0/32767/32767", "9/3/-3", "15/-1/0", "16/0/0"] {
        Image::fetch(&server, tile).await;
        Image::fetch(&server, tile).await;
    }
    let text = String::from_utf8(server.get("/metrics").await.body).unwrap();
    for line in [
        "tombolo_map_tile_requests_total{outcome=\"cache_hit\"} 5",
        "tombolo_map_tile_requests_total{outcome=\"rendered\"} 5",
        "tombolo_map_tile_requests_total{outcome=\"failed\"} 0",
    ] {
        assert!(text.lines().any(|found| found == line), "{line} is not in {text}");
    }
}
