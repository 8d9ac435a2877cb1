/// The letters of a page: whether they are large enough, and signs that every font has.

/// Letters that are smaller than 11 px on the screen, and what they say.
export const small = (page) =>
  page.evaluate(() => {
    const zoom = Number(/scale\(([\d.]+)\)/.exec(document.querySelector('.svelte-flow__viewport')?.style.transform ?? '')?.[1] ?? 1);
    const isSeen = (e) => e.getBoundingClientRect().width > 0 && getComputedStyle(e).visibility !== 'hidden';
    const isWritten = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
    return [...document.querySelectorAll('body *')].filter((e) => isWritten(e) && isSeen(e))
      .map((e) => ({ px: parseFloat(getComputedStyle(e).fontSize) * (e.closest('.svelte-flow__viewport') ? zoom : 1), text: e.textContent.trim().slice(0, 40) }))
      .filter(({ px }) => px < 10.99).map(({ px, text }) => `${px.toFixed(1)} px: ${text}`);
  });

/// Signs on the page that a font may lack, where they would be drawn as an empty box.
export const odd = (page) =>
  page.evaluate(() => {
    const said = [...document.querySelectorAll('body *')].flatMap((e) => [...e.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data)).join('');
    // Letters, punctuation, arrows and mathematics are in every font; dingbats and pictures are not.
    return [...new Set(said)].filter((c) => /[\u2300-\u27bf\u2900-\u29ff\u2b00-\u2bff\ue000-\uf8ff\ufffd]/.test(c) || c.codePointAt(0) > 0xffff);
  });
