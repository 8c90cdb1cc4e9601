/* Order of the results of a search: pages whose title or index (words.txt) has the words first, and
   practice before theory, the reference and benchmarks; names of objects only where they are asked
   for. The other values are those of Sphinx. */
var Scorer = {
    score: ([page, title, anchor, , score, , kind]) => {
        const query = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase();
        const words = query.split(/\s+/).filter(Boolean);
        const stems = words.map((word) => (word.length > 3 ? word.replace(/s$/, "") : word));
        const said = title.toLowerCase().split(/[^\w]+/);
        const inTitle = stems.filter((stem) => said.some((word) => word.startsWith(stem)));
        const folders = { how_to: 6, theory: 3, benchmarks: -4, api: -2, tutorials: 2 };
        const folder = folders[page.split("/")[0]] ?? 4;
        const unasked = kind === "object" && !query.includes("_") && said.at(-1) !== query;
        const list = page.endsWith("/index") || page === "changelog" || page === "features";
        return (
            score + (20 * inTitle.length) / stems.length + folder - (anchor ? 1 : 0)
            - (unasked ? 20 : 0) - (list ? 8 : 0)
        );
    },
    objNameMatch: 11,
    objPartialMatch: 6,
    objPrio: { 0: 15, 1: 5, 2: -5 },
    objPrioDefault: 0,
    title: 15,
    partialTitle: 7,
    term: 5,
    partialTerm: 2,
};
