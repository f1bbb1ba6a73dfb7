//! HTTP routes over real connections.
//!
//! | module | subject |
//! | --- | --- |
//! | `access` | host names, origins, tokens, shares of addresses |
//! | `proxies` | clients behind trusted proxies |
//! | `tls` | TLS |
//! | `memory` | the memory mark |
//! | `places` | places that many networks hold together |
//! | `caching` | validators, conditional requests, `Cache-Control` |
//! | `origins` | CORS |
//! | `rejections` | problem documents and their metrics |
//! | `disk` | the disk cache over restarts |
//! | `map` | map tiles |
//! | `stats` | live statistics |
//! | `page` | files and policy of the page |
//! | `world` | the description of the world |
//! | `openapi` | the OpenAPI document against the routes |
//! | `documents` | tables of the documents, and alerts, against a server |

mod access;
mod caching;
mod client;
mod disk;
mod documents;
mod map;
mod memory;
mod openapi;
mod origins;
mod page;
#[cfg(target_os = "linux")]
mod places;
mod proxies;
mod rejections;
mod stats;
mod tls;
mod world;
