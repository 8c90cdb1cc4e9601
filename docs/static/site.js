/* The button for light and dark is called by its name, not by its icons, which turn from <i> into
   <svg> while the page loads. */
window.addEventListener("DOMContentLoaded", () => {
    for (const button of document.querySelectorAll(".theme-switch-button")) {
        const mend = () => {
            for (const icon of button.querySelectorAll("i, svg")) {
                icon.setAttribute("aria-hidden", "true");
                icon.removeAttribute("title");
                icon.querySelector("title")?.remove();
            }
        };
        mend();
        new MutationObserver(mend).observe(button, { childList: true, subtree: true });
    }
});
/* Pictures lead to their files, so that details can be seen on small screens. */
window.addEventListener("DOMContentLoaded", () => {
    for (const picture of document.querySelectorAll(".bd-article img")) {
        if (!picture.closest("a")) {
            const link = document.createElement("a");
            link.href = picture.src;
            picture.replaceWith(link);
            link.append(picture);
        }
    }
});
