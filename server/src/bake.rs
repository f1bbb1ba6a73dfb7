//! `bake`: makes all chunks of a region and puts them into the store as packs.
//!
//! A bake can be split into parts, stopped and repeated: a valid pack is kept, and the same chunks
//! give the same bytes. The object of the region is written when all its packs are there, by
//! whichever part finds that first.

use crate::store::StoreAddress;
use crate::store::pack;
use crate::store::region::BakedRegion;
use crate::store::tile::{CHUNKS, ObjectNames, PackTile};
use bytes::Bytes;
use clap::Args;
use cli::UsageError;
use futures_util::future::ready;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::path::Path;
use object_store::{Error, GetOptions, ObjectStore, ObjectStoreExt};
use protocol::chunk_codec;
use rayon::prelude::*;
use std::ops::RangeInclusive;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use terrain::Land;
use tokio::task::{JoinError, JoinSet};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// Packs on their way to the store while further ones are made: at most 1 MiB each, usually.
const PUTS_IN_FLIGHT: usize = 4;

/// HEAD requests for packs at once.
const HEADS_IN_FLIGHT: usize = 32;

/// Timeout of one request; longer than a pack takes on a slow link.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);

/// Options of `bake`.
#[derive(Args, Clone, Debug)]
pub struct BakeArgs {
    /// Store that gets the chunks: a folder, file:///FOLDER, s3://BUCKET/PREFIX, gs://BUCKET/PREFIX
    /// or az://CONTAINER/PREFIX
    #[arg(long, value_name = "URL", env = "TOMBOLO_STORE")]
    pub store: String,
    /// Seed of the world, 0 to 18446744073709551615
    #[arg(long, value_name = "N", env = "TOMBOLO_WORLD_SEED", default_value_t = 1)]
    pub world_seed: u64,
    /// Levels of detail, finest and coarsest, 0 to 16; servers read 2 to 7
    #[arg(long, value_name = "A-B", default_value = "2-7", value_parser = levels)]
    pub levels: RangeInclusive<u8>,
    /// West, north, east and south border in metres from the origin; whole tiles of 16 x 16 chunks
    /// are baked
    #[arg(long, value_name = "W,N,E,S", default_value = "-8192,-8192,8192,8192",
          allow_hyphen_values = true, value_parser = area)]
    pub area: BakeArea,
    /// Part I of N, counted from 0; with an Indexed Job of Kubernetes $(JOB_COMPLETION_INDEX)/N
    #[arg(long, value_name = "I/N", default_value = "0/1", value_parser = part)]
    pub part: BakePart,
    /// Threads, 1 to 1024 [default: one per core]
    #[arg(long, value_name = "N", env = "TOMBOLO_THREADS",
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// A rectangle of the map, metres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BakeArea(pub [i32; 4]);

/// A part of a bake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BakePart {
    /// From 0.
    pub index: u64,
    /// Number of parts.
    pub of: u64,
}

/// The result of one part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Baked {
    /// Packs of the part that are in the store: kept or written.
    pub packs: u64,
    /// Of these, found valid in the store.
    pub kept: u64,
    /// Of these, made and written. A pack counts when the store has taken it.
    pub written: u64,
    /// Bytes written.
    pub bytes: u64,
    /// Reads that the store refused. S3 refuses reads of absent objects to a client that may not
    /// list the bucket, so each counts as one of an absent object.
    pub refused: u64,
    /// Whether the region is complete, so that servers use it.
    pub is_complete: bool,
    /// Whether it was stopped before its end.
    pub is_stopped: bool,
}

impl Baked {
    /// The store has taken a pack of this length.
    const fn written(&mut self, bytes: usize) {
        self.packs += 1;
        self.written += 1;
        self.bytes += bytes as u64;
    }
}

impl BakeArgs {
    /// Checks the options.
    ///
    /// # Errors
    /// An invalid address, region or part.
    pub fn resolve(self) -> Result<Bake, UsageError> {
        let address =
            StoreAddress::parse(&self.store).map_err(|why| UsageError::new(format!("--store: {why}")))?;
        let region = BakedRegion::new(&self.levels, self.area.0)
            .map_err(|why| UsageError::new(format!("--area: {why}")))?;
        let (objects, root) = address.open().map_err(|why| UsageError::new(format!("--store: {why}")))?;
        let land = Land::new(self.world_seed);
        Ok(Bake {
            names: ObjectNames::new(&root, &land.digest()),
            land,
            region,
            part: self.part,
            objects,
            threads: self.threads,
        })
    }
}

/// A bake that is ready to run.
#[derive(Debug)]
pub struct Bake {
    /// The land.
    pub land: Land,
    /// The region to bake.
    pub region: BakedRegion,
    /// Which part of it.
    pub part: BakePart,
    /// Where it goes.
    pub objects: Arc<dyn ObjectStore>,
    /// How its objects are named.
    pub names: ObjectNames,
    /// Threads; none for one per core.
    pub threads: Option<u16>,
}

impl Bake {
    /// Makes and writes the packs of the part; `progress` is called after each. Must run on threads
    /// that may block. When `stop` is cancelled, it ends after the packs that are being made or
    /// written.
    ///
    /// # Errors
    /// One line: the store failed, or the system has no threads.
    pub async fn run(
        &self,
        stop: &CancellationToken,
        mut progress: impl FnMut(&Baked, u64),
    ) -> Result<Baked, String> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads.map_or(0, usize::from))
            .build()
            .map_err(|error| format!("cannot start threads: {error}"))?;
        let world = self.land.digest();
        let BakePart { index, of } = self.part;
        let all = self.region.tile_count();
        let total = all / of + u64::from(all % of > index);
        let (mut baked, mut puts) = (Baked::default(), JoinSet::new());
        for tile in (0..).zip(self.region.tiles()).filter(|(n, _)| n % of == index).map(|(_, tile)| tile) {
            let path = self.names.pack(tile);
            let Some(stored) = stop.run_until_cancelled(self.stored(&path)).await else { break };
            let stored = stored?;
            baked.refused += u64::from(stored == Stored::Refused);
            if matches!(stored, Stored::Object(bytes) if pack::verify(&world, tile, &bytes).is_ok()) {
                (baked.packs, baked.kept) = (baked.packs + 1, baked.kept + 1);
                progress(&baked, total);
                continue;
            }
            let pack = pool.install(|| make(&self.land, &world, tile));
            while puts.len() >= PUTS_IN_FLIGHT
                && let Some(result) = puts.join_next().await
            {
                baked.written(ended(result)?);
                progress(&baked, total);
            }
            puts.spawn(put(Arc::clone(&self.objects), path, pack));
        }
        while let Some(result) = puts.join_next().await {
            baked.written(ended(result)?);
            progress(&baked, total);
        }
        // Also if it is stopped after its last pack: another run shows whether the region is
        // complete.
        match stop.run_until_cancelled(self.missing_pack()).await {
            Some(missing) => {
                let missing = missing?;
                baked.is_complete = missing.is_none();
                baked.refused += u64::from(missing == Some(Stored::Refused));
            }
            None => baked.is_stopped = true,
        }
        if baked.is_complete {
            self.complete().await?;
        }
        Ok(baked)
    }

    /// A whole pack, if there is one of a possible length.
    async fn stored(&self, path: &Path) -> Result<Stored, String> {
        let get = async {
            match self.objects.get_opts(path, GetOptions::default()).await {
                Ok(answer) if answer.meta.size > pack::MAX_PACK as u64 => Ok(Stored::Absent),
                Ok(answer) => answer.bytes().await.map(Stored::Object),
                Err(error) => Stored::without(error),
            }
        };
        within(get, path).await
    }

    /// The state of a pack of the region that does not exist; none if all do, those of other parts
    /// too.
    async fn missing_pack(&self) -> Result<Option<Stored>, String> {
        let heads = stream::iter(self.region.tiles())
            .map(|tile| self.head(self.names.pack(tile)))
            .buffer_unordered(HEADS_IN_FLIGHT);
        let missing = heads.try_filter(|stored| ready(!matches!(stored, Stored::Object(_))));
        pin!(missing).try_next().await
    }

    /// Writes the object of the region, whose packs all exist.
    async fn complete(&self) -> Result<(), String> {
        let region = serde_json::to_vec(&self.region).map_err(|error| error.to_string())?;
        put(Arc::clone(&self.objects), self.names.regions().join(self.region.name()), region.into()).await?;
        Ok(())
    }

    /// Whether an object exists; its bytes are not read.
    async fn head(&self, path: Path) -> Result<Stored, String> {
        let head = async {
            let found = self.objects.head(&path).await;
            found.map_or_else(Stored::without, |_| Ok(Stored::Object(Bytes::new())))
        };
        within(head, &path).await
    }
}

/// The answer of a store to a read.
#[derive(Debug, PartialEq, Eq)]
enum Stored {
    Object(Bytes),
    Absent,
    /// The client may not read it, or it is absent.
    Refused,
}

impl Stored {
    /// The answer of a failed read, if it is one.
    fn without(error: Error) -> object_store::Result<Self> {
        match error {
            Error::NotFound { .. } => Ok(Self::Absent),
            Error::PermissionDenied { .. } => Ok(Self::Refused),
            error => Err(error),
        }
    }
}

/// The pack of a tile.
fn make(land: &Land, world: &terrain::WorldDigest, tile: PackTile) -> Bytes {
    let frames: Vec<Option<Bytes>> = (0..CHUNKS)
        .into_par_iter()
        .map(|index| tile.chunk(index).map(|key| chunk_codec::encode(&land.chunk(key), world)))
        .collect();
    pack::encode(world, tile, &frames)
}

/// Puts an object. Returns its length.
async fn put(objects: Arc<dyn ObjectStore>, path: Path, bytes: Bytes) -> Result<usize, String> {
    let length = bytes.len();
    within(async { objects.put(&path, bytes.into()).await.map(|_| length) }, &path).await
}

/// The result of a request, with its errors as one line.
async fn within<T>(request: impl Future<Output = object_store::Result<T>>, path: &Path) -> Result<T, String> {
    match timeout(REQUEST_TIMEOUT, request).await {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(error)) => {
            let line = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
            let cure = match error {
                Error::PermissionDenied { .. } => "give the credentials the right to put objects",
                Error::Unauthenticated { .. } => "give valid credentials in the environment",
                _ => "what is written stays, run the same command again",
            };
            Err(format!("the store failed: {line}; {cure}"))
        }
        Err(_) => Err(format!("the store did not answer within {REQUEST_TIMEOUT:?} ({path}); run it again")),
    }
}

/// The length of a finished write.
fn ended(joined: Result<Result<usize, String>, JoinError>) -> Result<usize, String> {
    joined.map_err(|error| format!("a write failed: {error}"))?
}

fn levels(text: &str) -> Result<RangeInclusive<u8>, String> {
    let (finest, coarsest) = text.split_once('-').unwrap_or((text, text));
    match (finest.parse(), coarsest.parse()) {
        (Ok(finest), Ok(coarsest)) if finest <= coarsest && coarsest <= 16 => Ok(finest..=coarsest),
        _ => Err("give the finest and the coarsest level, such as 2-7".into()),
    }
}

fn area(text: &str) -> Result<BakeArea, String> {
    let borders: Result<Vec<i32>, _> = text.split(',').map(|border| border.trim().parse()).collect();
    let borders = borders.ok().and_then(|borders| <[i32; 4]>::try_from(borders).ok());
    borders.map(BakeArea).ok_or_else(|| "give west,north,east,south in whole metres".into())
}

fn part(text: &str) -> Result<BakePart, String> {
    let numbers = text.split_once('/').and_then(|(index, of)| Some((index.parse().ok()?, of.parse().ok()?)));
    match numbers {
        Some((index, of)) if index < of => Ok(BakePart { index, of }),
        _ => Err("give I/N with I from 0 to N - 1, such as 0/4".into()),
    }
}

#[cfg(test)]
mod tests;
