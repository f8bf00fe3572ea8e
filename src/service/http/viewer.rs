//! `/` and `/assets/{name}`: the web viewer, which is embedded at build time, and the mesh of the default body.
//!
//! The page cannot load anything from other sites or run inline code: its `Content-Security-Policy` allows only its own
//! scripts, styles and requests.

use super::conditions::is_unchanged;
use super::error::Problem;
use crate::export::{BodyMesh, default_body_mesh};
use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use tokio::sync::OnceCell;

/// One file of the built page.
struct Asset {
    /// Path below the page's folder.
    name: &'static str,
    bytes: &'static [u8],
}

/// Every file of the page; empty if the program was built without the viewer.
const ASSETS: &[Asset] = include!(concat!(env!("OUT_DIR"), "/viewer_assets.rs"));

/// The page of a program that was built without the viewer.
const PLAIN_PAGE: &str = "<!doctype html>
<html lang=\"en\"><meta charset=\"utf-8\"><title>wandless</title>
<h1>wandless is running</h1>
<p>This program was built without its web viewer, because Node.js or the packages of <code>web/</code> were missing.
The API is at <a href=\"/v1/jobs\">/v1</a>. To get the viewer, install Node.js 20.19 or later, touch
<code>web/package.json</code> and build again.</p>
</html>
";

/// `script-src` and `style-src` exclude `unsafe-inline`: HTML inside a name is not executed. Images that the page itself makes
/// (downloads, favicons) are `blob:` and `data:`, and so are videos that the user picks on the own disk.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: \
     blob:; media-src blob:; connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Whether the program contains the page.
pub(super) fn has_page() -> bool {
    !ASSETS.is_empty()
}

/// The viewer's routes.
pub(super) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    Router::new()
        .route("/", get(page))
        .route("/assets/default-body.bin", get(default_body))
        .route("/assets/{*name}", get(asset))
}

/// The mesh of the default body, computed at the first request. Its name has no digest, so browsers revalidate it; body models
/// that an operator registered are never sent.
async fn default_body(headers: HeaderMap) -> Result<Response, Problem> {
    static MESH: OnceCell<BodyMesh> = OnceCell::const_new();
    let make = || async {
        tokio::task::spawn_blocking(default_body_mesh)
            .await
            .map_err(Problem::internal)?
            .map_err(|error| Problem::from_io(&error))
    };
    let mesh = MESH.get_or_try_init(make).await?;
    let tag = format!("\"{}\"", mesh.sha256);
    if is_unchanged(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response());
    }
    let mut response = answer(&Asset { name: "default-body.bin", bytes: &mesh.bytes }, "no-cache");
    response.headers_mut().insert(header::ETAG, HeaderValue::from_str(&tag).map_err(Problem::internal)?);
    Ok(response)
}

async fn page() -> Response {
    match ASSETS.iter().find(|asset| asset.name == "index.html") {
        Some(page) => answer(page, "no-cache"),
        None => answer(&Asset { name: "index.html", bytes: PLAIN_PAGE.as_bytes() }, "no-cache"),
    }
}

/// A script or a style sheet; its name contains the digest of its content, so it can be cached for ever.
async fn asset(Path(name): Path<String>) -> Result<Response, Problem> {
    let found = ASSETS.iter().find(|asset| asset.name.strip_prefix("assets/") == Some(name.as_str()));
    found.map(|asset| answer(asset, "public, max-age=31536000, immutable")).ok_or_else(|| {
        let detail = "the viewer does not contain this file";
        Problem::new(StatusCode::NOT_FOUND, "not_found", detail, "reload the page")
    })
}

fn answer(asset: &Asset, cache_control: &'static str) -> Response {
    let headers = [
        (header::CONTENT_TYPE, media_type(asset.name)),
        (header::CACHE_CONTROL, cache_control),
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    (headers, asset.bytes).into_response()
}

fn media_type(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest total size of scripts and styles, bytes.
    const MAX_ASSETS: usize = 3_000_000;

    #[tokio::test]
    async fn page_has_a_policy_without_inline_code() {
        let response = page().await;
        assert_eq!(response.status(), StatusCode::OK);
        let policy = response.headers()[header::CONTENT_SECURITY_POLICY].to_str().unwrap();
        assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    }

    #[tokio::test]
    async fn missing_asset_is_a_problem() {
        assert!(asset(Path("../index.html".to_owned())).await.is_err());
    }

    #[tokio::test]
    async fn unchanged_default_body_is_answered_304() {
        let first = default_body(HeaderMap::new()).await.unwrap();
        let tag = first.headers()[header::ETAG].clone();
        let again = default_body(HeaderMap::from_iter([(header::IF_NONE_MATCH, tag)])).await.unwrap();
        assert_eq!((first.status(), again.status()), (StatusCode::OK, StatusCode::NOT_MODIFIED));
    }

    /// Pages of a plain HTTP address other than the loopback have no `randomUUID`: no dialogue opened there.
    #[test]
    fn viewer_needs_no_secure_context() {
        let needs = |asset: &Asset| asset.bytes.windows(10).any(|text| text == b"randomUUID");
        assert!(!ASSETS.iter().any(needs));
    }

    #[test]
    fn viewer_is_small_and_has_no_inline_code() {
        let bytes: usize = ASSETS.iter().map(|asset| asset.bytes.len()).sum();
        assert!(bytes <= MAX_ASSETS, "{bytes}");
        let page = ASSETS.iter().find(|asset| asset.name == "index.html").map_or(PLAIN_PAGE.as_bytes(), |p| p.bytes);
        let page = String::from_utf8(page.to_vec()).unwrap();
        assert!(!page.contains("<style") && !page.contains("style=") && !page.contains("onclick"));
        assert!(page.split("<script").skip(1).all(|tag| tag.contains("src=") && tag.contains("></script>")));
    }
}
